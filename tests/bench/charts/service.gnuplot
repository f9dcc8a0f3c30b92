# Draws the charts of service.csv. usage, from tests/bench: gnuplot charts/service.gnuplot
# Columns: 1 experiment, 2 scene, 3 rays, 4 streams, 5 batch, 6 quantity, 7 value, 8 spread.
set datafile separator ','
set terminal svg noenhanced size 960,360 font 'sans-serif,12' background 'white'
set grid linecolor '#dddddd'
set border 3
set tics nomirror
set logscale x 2
set xlabel 'rays a batch'
set yrange [0:*]

rows(rays, streams, quantity) = sprintf("< grep -E '^throughput,[a-z]+,%s,%s,[0-9]+,%s,' results/service.csv", \
                                        rays, streams, quantity)

set output 'charts/service.svg'
set multiplot layout 1,2 margins 0.06,0.98,0.14,0.90 spacing 0.08,0.1
set title 'camera rays: millions a second, by streams'
set key bottom right samplen 2
plot for [s in '1 4 16'] rows('camera', s, 'mrays_s') using 5:7 with linespoints pt 7 title s
set title 'processor seconds per million rays beyond tracing'
set logscale y
set yrange [*:*]
set key top right
plot rows('miss', '1', 'beyond_kernel_cpu_s_per_mray') using 5:7 with linespoints pt 7 lc '#1b4f8a' title 'rays that miss', \
     rows('camera', '1', 'beyond_kernel_cpu_s_per_mray') using 5:7 with linespoints pt 7 lc '#4477aa' title 'camera rays', \
     rows('bounce', '1', 'beyond_kernel_cpu_s_per_mray') using 5:7 with linespoints pt 7 lc '#99bbdd' title 'bounces', \
     rows('miss', '1', 'client_cpu_s_per_mray') using 5:7 with linespoints pt 6 lc '#aa6644' title 'of which client'
unset multiplot
