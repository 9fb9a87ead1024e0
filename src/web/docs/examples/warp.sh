curl -sS --fail-with-body http://127.0.0.1:8080/page/cat.jpg -o cat.jpg

curl -sS --fail-with-body http://127.0.0.1:8080/warp -o warped.png \
  -F image=@cat.jpg \
  -F 'warp={"p": [[168, 112], [316, 136], [262, 240]],
            "q": [[150, 104], [338, 126], [262, 262]]}'
