for method in rigid similarity affine; do
  curl -sS --fail-with-body http://127.0.0.1:8080/warp -o "$method.jpg" \
    -F image=@cat.jpg \
    -F 'warp={"p": [[168, 112], [316, 136], [262, 240]],
              "q": [[140, 90], [345, 130], [262, 270]],
              "method": "'"$method"'", "alpha": 1.5, "output": {"format": "jpeg"}}'
done
