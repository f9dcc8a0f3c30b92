# Draws the charts of paper.csv. usage, from tests/bench: gnuplot charts/paper.gnuplot
# Columns: 1 experiment, 2 scene, 3 engine, 4 alpha, 5 delta, 6-8 build seconds (median, low, high), 9-11 render seconds,
# 12 build_relative, 13 render_speedup.
set datafile separator ','
set terminal svg noenhanced size 640,400 font 'sans-serif,12' background 'white'
set grid ytics linecolor '#dddddd'
set border 3
set tics nomirror
set key top left

data = 'results/paper.csv'
of(name, column) = strcol(1) eq name ? column : NaN

set output 'charts/figure_1.svg'
set title 'Figure 1: render time against α (bunny, δ = 32, as printed)'
set xlabel 'α'
set ylabel 'CPU seconds'
set yrange [0:*]
plot data using 4:(of('figure_1', $9)):10:11 every ::1 with yerrorlines linewidth 2 pointtype 7 notitle

set output 'charts/figure_2.svg'
set title 'Figure 2: build time and render speed against δ, relative to δ = 1'
set xlabel 'δ'
set ylabel 'relative to δ = 1'
set logscale x 2
plot data using 5:(of('figure_2', $12)) every ::1 with linespoints linewidth 2 pointtype 7 title 'build time', \
     data using 5:(of('figure_2', $13)) every ::1 with linespoints linewidth 2 pointtype 5 title 'render speed'
unset logscale x

set output 'charts/table_4.svg'
set title 'Table 4: render time relative to the BVH (640 × 480; less is better)'
set xlabel ''
set ylabel 'render time / BVH''s'
set style fill solid 0.8
set boxwidth 0.7
set key off
set xtics rotate by -30
set yrange [0:*]
plot "< grep '^table_4' results/paper.csv" using 0:(1 / $13):xtic(strcol(2).' '.strcol(3)) with boxes linecolor '#4477aa'
