# Draws the chart of accuracy.csv. usage, from tests/bench: gnuplot charts/accuracy.gnuplot
# Columns: 1 family, 2 engine, 3 structure, 4 level, 5 rays, 6 false_miss, 7 false_hit, 8 wrong_surface,
# 9 wrong_primitive, 10 t_ulp_p999, 11 t_ulp_max, 12 uv_error_max, 13 exact_decisions, 14 ns_per_ray.
# Wrong are false misses, false hits and wrong surfaces; none is drawn at the lower end. A ray's time is the geometric
# mean over families. Families that Embree was not asked are left out.
set datafile separator whitespace
set terminal svg noenhanced size 960,460 font 'sans-serif,12' background 'white'
set grid xtics ytics linecolor '#dddddd'
set border 3
set tics nomirror
set logscale xy
set yrange [0.5:300000]
set ytics ('none' 1, '10' 10, '100' 100, '1 000' 1000, '10 000' 10000, '100 000' 100000)
set xlabel 'ns per ray, one thread'

point(ordinary, structure, level) = "< awk -F, -v ordinary=".ordinary." -v structure=".structure." -v level=".level." ' \
  NR == FNR { if ($2 == \"embree\") { asked[$1] = 1; ++all } next } \
  FNR > 1 && (!all || $1 in asked) && $3 == structure && $4 == level && \
  ($1 ~ /^(scan_camera|scan_chords|scan_bounce|city_chords|soup_chords)$/) == ordinary { \
    ++n; log_ns += log($14); rays += $5; wrong += $6 + $7 + $8 } \
  END { if (n) print exp(log_ns / n), wrong ? 1e6 * wrong / rays : 1 }' results/accuracy.csv results/accuracy.csv"

set output 'charts/accuracy.svg'
set multiplot layout 1,2 margins 0.10,0.79,0.13,0.92 spacing 0.07,0.1
do for [ordinary in '1 0'] {
  set title ordinary eq '1' ? 'Ordinary rays' : 'Rays where methods fail'
  if (ordinary eq '1') { set ylabel 'wrong answers per million'; set xrange [30:1500] } else { unset ylabel; set xrange [100:5000] }
  if (ordinary eq '1') { set key at screen 0.995,0.92 right top samplen 1 spacing 1.15 } else { unset key }
  plot point(ordinary, 'hybrid', 'exact') with points pt 7 ps 1.6 lc '#1b4f8a' title 'hybrid EXACT', \
       point(ordinary, 'hybrid', 'watertight') with points pt 5 ps 1.4 lc '#1b4f8a' title 'hybrid WATERTIGHT', \
       point(ordinary, 'hybrid', 'fast') with points pt 9 ps 1.6 lc '#1b4f8a' title 'hybrid FAST', \
       point(ordinary, 'bvh', 'exact') with points pt 6 ps 1.9 lc '#449944' title 'BVH EXACT', \
       point(ordinary, 'bvh', 'watertight') with points pt 4 ps 1.7 lc '#449944' title 'BVH WATERTIGHT', \
       point(ordinary, 'bvh', 'fast') with points pt 8 ps 1.9 lc '#449944' title 'BVH FAST', \
       point(ordinary, 'kd_tree', 'exact') with points pt 6 ps 1.4 lc '#aa3377' title 'kd-tree EXACT', \
       point(ordinary, 'tang2015', 'exact') with points pt 6 ps 1.4 lc '#777777' title '[Tang 2015] EXACT', \
       point(ordinary, 'high', 'robust') with points pt 5 ps 1.4 lc '#dd7733' title 'Embree ROBUST', \
       point(ordinary, 'high', 'fast') with points pt 9 ps 1.6 lc '#dd7733' title 'Embree'
}
unset multiplot
