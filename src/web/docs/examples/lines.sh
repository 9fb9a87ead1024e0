curl -sS --fail-with-body http://127.0.0.1:8080/warp -o lines.png \
  -F image=@cat.jpg \
  -F 'warp={"p": [[242, 185], [[0, 290], [225, 280], [451, 290]]],
            "q": [[242, 160], [[0, 290], [225, 280], [451, 290]]],
            "weights": [2, 1]}'
