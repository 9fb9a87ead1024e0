// Pixels of public/cat.jpg: three points of the cat.
export const p = [
  [168, 112],
  [316, 136],
  [262, 240],
];
