cat > rest.pts <<'END'
version: 1
n_points: 3
{
168.5 112.5
316.5 136.5
262.5 240.5
}
END
printf 'x,y\n150,104\n338,126\n262,262\n' > posed.csv

curl -sS --fail-with-body http://127.0.0.1:8080/warp -o landmarks.png \
  -F image=@cat.jpg \
  -F landmarks_p=@rest.pts \
  -F landmarks_q=@posed.csv
