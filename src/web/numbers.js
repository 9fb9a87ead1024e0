// Which numbers of handles have room. A number covers neither another number nor another handle; of
// two that collide, the first one stays.

/** Up to this many selected handles all have their numbers. */
const FEW = 12;
/**
 * Size of a number (per character, and height), its offset from the handle, and the radius of a
 * handle, CSS px.
 */
const [WIDE, HIGH, ABOVE, DOT] = [7.5, 13, 19, 8];
const CELL = 32;

/**
 * @typedef {[left: number, top: number, right: number, bottom: number, owner: number]} NumberBox
 */

/**
 * The labels with room: a Set of indices of `marks`, [x, y, text, wanted] in stage px.
 * @param {[x: number, y: number, text: string, wanted: boolean][]} marks
 */
export function withRoom(marks) {
  const wanted = marks.map((mark, k) => (mark[3] ? k : -1)).filter((k) => k >= 0);
  if (wanted.length <= FEW) return new Set(wanted);
  /** @type {Map<string, NumberBox[]>} */
  const taken = new Map(); // cell to boxes: [left, top, right, bottom, owner]
  /** @type {(box: NumberBox, visit: (cell: string) => unknown) => boolean} */
  const cells = ([left, top, right, bottom], visit) => {
    for (let j = Math.floor(top / CELL); j <= Math.floor(bottom / CELL); j++) {
      for (let i = Math.floor(left / CELL); i <= Math.floor(right / CELL); i++)
        if (visit(`${i},${j}`)) return true;
    }
    return false;
  };
  /** @type {(box: NumberBox) => void} */
  const put = (box) =>
    void cells(box, (cell) => void (taken.get(cell)?.push(box) ?? taken.set(cell, [box])));
  /** @type {(a: NumberBox, b: NumberBox) => boolean} */
  const overlap = (a, b) =>
    a[4] !== b[4] && a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];
  /** @type {(box: NumberBox) => boolean} */
  const meets = (box) =>
    cells(box, (cell) => taken.get(cell)?.some((other) => overlap(other, box)));
  marks.forEach(([x, y], k) => put([x - DOT, y - DOT, x + DOT, y + DOT, k]));
  return new Set(
    wanted.filter((k) => {
      const [x, y, text] = marks[k];
      const half = (WIDE * text.length) / 2;
      /** @type {NumberBox} */
      const box = [x - half, y - ABOVE - HIGH / 2, x + half, y - ABOVE + HIGH / 2, k];
      if (meets(box)) return false;
      put(box);
      return true;
    }),
  );
}
