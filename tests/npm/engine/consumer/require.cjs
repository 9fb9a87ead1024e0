// `require` of a module, Node 20.19 and later.

const { createHash } = require("node:crypto");
const { readFileSync } = require("node:fs");
const { Engine } = require("mlswarp/engine");
const sha = (bytes) => createHash("sha256").update(bytes).digest("hex");

Engine.load().then((engine) => {
  const file = readFileSync("../../../../images/chelsea.png");
  const made = engine.warpFile(file, JSON.parse(readFileSync("cat.json", "utf8")));
  if (sha(made) !== sha(readFileSync("../expected/cat.png"))) throw new Error("other bytes");
});
