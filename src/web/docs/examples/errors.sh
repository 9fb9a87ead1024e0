curl -sS http://127.0.0.1:8080/warp -F image=@cat.jpg \
  -F 'warp={"p": [[168, 112]], "q": [[150, 104]], "metod": "rigid"}' | jq -e '.code, .pointer, .detail'
