import { headers, server, show } from "./here.js";

// ibug .pts counts from 1
const rest = "version: 1\nn_points: 3\n{\n168.5 112.5\n316.5 136.5\n262.5 240.5\n}\n";
const posed = "x,y\n150,104\n338,126\n262,262\n"; // CSV in px

const form = new FormData();
form.set("image", await (await fetch(`${server}page/cat.jpg`)).blob());
form.set("landmarks_p", new Blob([rest]));
form.set("landmarks_q", new Blob([posed]));
await show(await fetch(`${server}warp`, { method: "POST", headers: headers(), body: form }));

// From OpenCV or dlib in your own program: add 0.5.
const fromPixelIndices = (points) => points.map(([x, y]) => [x + 0.5, y + 0.5]);
show({ p: fromPixelIndices([[168, 112], [316, 136]]) });
