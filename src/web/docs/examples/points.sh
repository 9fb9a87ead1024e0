curl -sS --fail-with-body http://127.0.0.1:8080/points -H 'Content-Type: application/json' \
  -d '{"extent": [451, 300],
       "p": [[168, 112], [316, 136], [262, 240]],
       "q": [[150, 104], [338, 126], [262, 262]],
       "points": [[168, 112], [240, 180]]}' | jq -e .points
