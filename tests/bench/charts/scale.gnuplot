# Draws the charts of scale.csv. usage, from tests/bench: gnuplot charts/scale.gnuplot
# Columns: 1 scene, 2 triangles, 3 rays, 4 engine, 5 mode, 6 level, 7 mrays_s, 8 spread, 9 build_seconds,
# 10 build_cpu_seconds, 11 bytes_per_triangle, 12 peak_bytes_per_triangle.
set datafile separator ','
set terminal svg noenhanced size 960,640 font 'sans-serif,12' background 'white'
set grid linecolor '#dddddd'
set border 3
set tics nomirror
set logscale xy
set format x '%.0s%c'
set xlabel 'triangles'
set key at screen 0.99,0.92 right top samplen 2

rows(scene, rays, engine, level, mode) = sprintf("< grep -E '^%s,[0-9]+,%s,%s,%s,%s,' results/scale.csv", \
                                                 scene, rays, engine, mode, level)

set output 'charts/scale.svg'
set multiplot layout 2,2 margins 0.06,0.80,0.09,0.94 spacing 0.08,0.16
do for [scene in 'terrain soup'] {
  if (scene eq 'soup') { unset key }
  set title scene.': millions of rays per second, one thread'
  plot rows(scene, 'chords', 'deltaray', 'exact', 'batch') using 2:7 with linespoints pt 7 lc '#1b4f8a' title 'chords: EXACT', \
       rows(scene, 'chords', 'deltaray', 'watertight', 'batch') using 2:7 with linespoints pt 7 lc '#4477aa' title 'WATERTIGHT', \
       rows(scene, 'chords', 'embree', 'fast', '1M') using 2:7 with linespoints pt 7 lc '#aa6644' title 'Embree', \
       rows(scene, 'bounce', 'deltaray', 'exact', 'batch') using 2:7 with linespoints pt 6 lc '#1b4f8a' title 'bounces: EXACT', \
       rows(scene, 'bounce', 'deltaray', 'watertight', 'batch') using 2:7 with linespoints pt 6 lc '#4477aa' title 'WATERTIGHT', \
       rows(scene, 'bounce', 'embree', 'fast', '1M') using 2:7 with linespoints pt 6 lc '#aa6644' title 'Embree'
}
do for [scene in 'terrain soup'] {
  set title scene.': processor seconds to build'
  if (scene eq 'soup') { unset key } else { set key at screen 0.99,0.40 right top samplen 2 }
  plot rows(scene, 'chords', 'deltaray', 'exact', 'batch') using 2:10 with linespoints pt 7 lc '#1b4f8a' title 'balanced', \
       rows(scene, 'chords', 'embree', 'fast', '1M') using 2:10 with linespoints pt 7 lc '#aa6644' title 'Embree HIGH'
}
unset multiplot
