curl -sS --fail-with-body http://127.0.0.1:8080/warp -o small.jpg \
  -F image=@cat.jpg \
  -F 'warp={"p": [[168, 112], [316, 136]], "q": [[120, 112], [316, 136]],
            "output": {"format": "jpeg", "quality": 80, "width": 225, "outside": "edge"}}'
