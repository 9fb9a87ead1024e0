set -e -o pipefail
SESSION=$(curl -sS --fail-with-body http://127.0.0.1:8080/sessions \
  -F image=@cat.jpg \
  -F 'warp={"p": [[168, 112], [316, 136], [262, 240]]}' | jq -r '.id // empty')

# Usually a mask or labels; here the image itself.
curl -sS --fail-with-body "http://127.0.0.1:8080/sessions/$SESSION/layers/copy" -T cat.jpg | jq .layers

for layer in copy @coverage; do
  curl -sS --fail-with-body "http://127.0.0.1:8080/sessions/$SESSION/warp" -o "layer-$layer.png" \
    -H 'Content-Type: application/json' \
    -d '{"q": [[150, 104], [338, 126], [262, 262]], "layer": "'"$layer"'"}'
done

curl -sS --fail-with-body -X DELETE "http://127.0.0.1:8080/sessions/$SESSION"
