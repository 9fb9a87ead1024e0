// What a program with strict types writes.

import { Engine, MlswarpError, type Plan, type Pose } from "mlswarp/engine";
import { Engine as Inline } from "mlswarp/engine/inline";

export async function warped(image: ImageData): Promise<Blob> {
  const engine = await Engine.load();
  const plan: Plan = engine.plan(
    [
      [10, 10],
      [
        [20, 20],
        [30, 40],
      ],
    ],
    {
      size: [image.width, image.height],
      method: "similarity",
      alpha: 1.5,
    },
  );
  const pose: Pose = plan.pose(
    [
      [12, 10],
      [
        [20, 22],
        [30, 44],
      ],
    ],
    0.5,
  );
  const drawn = pose.warp(image, { outside: "#ff0000", canvas: "fit" });
  const x: number = pose.points([[1, 2]])[0];
  const labels: Uint16Array = pose.labels({ width: 1, height: 1, data: new Uint16Array(1) }).data;
  const mean = engine.blend([image, image], {
    images: [
      { image: 0, p: [[1, 2]] },
      { image: 1, p: [[2, 2]] },
    ],
  });
  const faces: number[] = mean.folds;
  pose.dispose();
  plan.dispose();
  // A view of memory could not become part of a Blob.
  const file = engine.warpFile(new Uint8Array(0), { p: [[1, 2]], q: [[1, 2]], method: "auto" });
  return new Blob([file, String(x), String(faces), labels as Uint16Array<ArrayBuffer>, drawn.data]);
}

export async function code(): Promise<string | undefined> {
  const engine: Engine = await Inline.load();
  try {
    // @ts-expect-error a size is a pair
    engine.plan([[1, 2]], { size: 3 });
  } catch (error) {
    if (error instanceof MlswarpError) return error.code + (error.pointer ?? "");
  }
  return undefined;
}
