import { show } from "./here.js";

// ibug and 300-W .pts: pixel indices that count from 1.
const pts = (text) =>
  text.slice(text.indexOf("{") + 1, text.indexOf("}")).trim().split("\n")
    .map((line) => line.trim().split(/\s+/).map((number) => Number(number) - 0.5));

// OpenCV, dlib: pixel indices that count from 0.
const pixelIndices = (points) => points.map(([x, y]) => [x + 0.5, y + 0.5]);

// MediaPipe: objects with x and y from 0 to 1.
const normalized = (landmarks) => ({ p: landmarks.map(({ x, y }) => [x, y]), units: "normalized" });

show({ p: pts("version: 1\nn_points: 2\n{\n169 113\n317 137\n}\n") });
show({ p: pixelIndices([[168, 112], [316, 136]]) });
show(normalized([{ x: 0.37, y: 0.37, z: 0 }]));
