# Draws the charts of build.csv. usage, from tests/bench: gnuplot charts/build.gnuplot
# Columns: 1 scene, 2 engine, 3 preset, 4 threads, 5 seconds, 6 cpu_seconds, 7 bytes_per_triangle,
# 8 peak_bytes_per_triangle, 9 sah_cost, 10 references, 11 max_depth.
set datafile separator whitespace
set terminal svg noenhanced size 960,360 font 'sans-serif,12' background 'white'
set grid ytics linecolor '#dddddd'
set border 3
set tics nomirror
set style data histograms
set style histogram clustered gap 1
set style fill solid 0.85
set boxwidth 0.9
set yrange [0:*]
set key at screen 0.99,0.85 right top samplen 1
set xtics rotate by -30

# `column` of our presets and Embree's qualities with one thread, by scene; divided by that of Embree's HIGH with by=1.
bars(column, by) = "< awk -F, -v column=".column." -v by=".by." ' \
  $4 == 1 && ($2 == \"hybrid\" || $2 == \"embree\") { \
    if (!($1 in seen)) { seen[$1] = 1; scenes[++n] = $1 } value[$1 \" \" $3] = $column } \
  END { for (i = 1; i <= n; ++i) { s = scenes[i]; unit = by ? value[s \" high\"] : 1; if (!unit) unit = 1; \
    print s, value[s \" fast\"] / unit, value[s \" balanced\"] / unit, value[s \" best\"] / unit, \
          value[s \" medium\"] / unit, value[s \" high\"] / unit } }' results/build.csv"

set output 'charts/build.svg'
set multiplot layout 1,3 margins 0.04,0.81,0.18,0.90 spacing 0.05,0.1
set title 'processor seconds / Embree HIGH''s'
plot bars('6', '1') using 2:xtic(1) title 'fast' linecolor '#99bbdd', '' using 3 title 'balanced' linecolor '#4477aa', \
     '' using 4 title 'best' linecolor '#1b4f8a', '' using 5 title 'Embree MEDIUM' linecolor '#ddaa88', \
     '' using 6 title 'Embree HIGH' linecolor '#aa6644'
unset key
set title 'bytes a triangle'
plot bars('7', '0') using 2:xtic(1) linecolor '#99bbdd', '' using 3 linecolor '#4477aa', \
     '' using 4 linecolor '#1b4f8a', '' using 5 linecolor '#ddaa88', '' using 6 linecolor '#aa6644'
set title 'peak bytes a triangle, building'
plot bars('8', '0') using 2:xtic(1) linecolor '#99bbdd', '' using 3 linecolor '#4477aa', \
     '' using 4 linecolor '#1b4f8a', '' using 5 linecolor '#ddaa88', '' using 6 linecolor '#aa6644'
unset multiplot
