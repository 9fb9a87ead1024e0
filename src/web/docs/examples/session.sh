set -e -o pipefail
SESSION=$(curl -sS --fail-with-body http://127.0.0.1:8080/sessions \
  -F image=@cat.jpg \
  -F 'warp={"p": [[168, 112], [316, 136], [262, 240]]}' | jq -r '.id // empty')

for x in 150 140 130; do
  curl -sS --fail-with-body "http://127.0.0.1:8080/sessions/$SESSION/warp" -o "drag-$x.png" \
    -H 'Content-Type: application/json' \
    -d '{"seq": '"$((200 - x))"', "q": [['"$x"', 104], [338, 126], [262, 262]]}'
done

curl -sS --fail-with-body -X DELETE "http://127.0.0.1:8080/sessions/$SESSION"
