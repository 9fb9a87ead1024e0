set -e -o pipefail
# Without handles: jitter moves a grid of points. With steps, send handles as `p` here, and `q` below.
SESSION=$(curl -sS --fail-with-body http://127.0.0.1:8080/sessions -F image=@cat.jpg -F 'warp={}' | jq -r '.id // empty')

curl -sS --fail-with-body "http://127.0.0.1:8080/sessions/$SESSION/batch" -o batch.zip \
  -H 'Content-Type: application/json' \
  -d '{"jitter": {"seed": 7, "count": 20, "sigma": 4},
       "output": {"format": "jpeg"},
       "boxes": [[140, 80, 190, 130], [290, 110, 335, 150]]}'

python3 -m zipfile -e batch.zip batch
jq -c .boxes batch/0000.json

curl -sS --fail-with-body -X DELETE "http://127.0.0.1:8080/sessions/$SESSION"
