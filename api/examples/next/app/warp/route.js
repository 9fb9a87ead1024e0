// POST /warp with `q`: the PNG of the warped cat.

import { readFile } from "node:fs/promises";
import { Engine, MlswarpError } from "mlswarp/engine";
import { p } from "../handles.js";

const opened = Promise.all([Engine.load(), readFile("public/cat.jpg")]);

export async function POST(request) {
  const [engine, cat] = await opened;
  try {
    const q = (await request.json())?.q;
    const file = engine.warpFile(cat, { p, q, output: { format: "png" } });
    return new Response(file, { headers: { "Content-Type": "image/png" } });
  } catch (error) {
    const isAsked = error instanceof MlswarpError || error instanceof SyntaxError;
    return new Response(error.message, { status: isAsked ? 400 : 500 });
  }
}
