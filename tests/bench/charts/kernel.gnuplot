# Draws the charts of kernel.csv. usage, from tests/bench: gnuplot charts/kernel.gnuplot
# Columns: 1 scene, 2 rays, 3 engine, 4 mode, 5 level, 6 threads, 7 mrays_s, 8 spread.
# Of deltaray the traversal that it chooses itself is drawn, of Embree the fastest of its calls.
set datafile separator whitespace
set terminal svg noenhanced size 960,640 font 'sans-serif,12' background 'white'
set grid ytics linecolor '#dddddd'
set border 3
set tics nomirror
set style data histograms
set style histogram clustered gap 1
set style fill solid 0.85
set boxwidth 0.9
set yrange [0:*]

bars(rays, threads) = "< awk -F, -v rays=".rays." -v threads=".threads." ' \
  $2 == rays && $6 == threads && ($3 == \"embree\" || $4 == \"auto\") { \
    if (!($1 in seen)) { seen[$1] = 1; scenes[++n] = $1 } \
    key = $1 \" \" $3 \" \" $5; if ($7 + 0 > best[key] + 0) best[key] = $7 } \
  END { for (i = 1; i <= n; ++i) { s = scenes[i]; \
    print s, best[s \" deltaray exact\"] + 0, best[s \" deltaray watertight\"] + 0, best[s \" deltaray fast\"] + 0, \
          best[s \" embree robust\"] + 0, best[s \" embree fast\"] + 0 } }' results/kernel.csv"

do for [threads = 1:2] {
  set output sprintf('charts/kernel_%d.svg', threads)
  set multiplot layout 2,2 margins 0.05,0.99,0.06,0.84 spacing 0.05,0.13 \
      title sprintf('Millions of rays per second, %d thread%s', threads, threads > 1 ? 's' : '')
  do for [rays in 'camera bounce chords shadow'] {
    set title rays
    if (rays eq 'camera') { set key at screen 0.5,0.94 center top horizontal samplen 1 } else { unset key }
    plot bars(rays, sprintf('%d', threads)) using 2:xtic(1) title 'deltaray EXACT' linecolor '#1b4f8a', \
         '' using 3 title 'WATERTIGHT' linecolor '#4477aa', '' using 4 title 'FAST' linecolor '#99bbdd', \
         '' using 5 title 'Embree ROBUST' linecolor '#aa6644', '' using 6 title 'Embree' linecolor '#ddaa88'
  }
  unset multiplot
}
