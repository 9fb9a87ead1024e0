// The twist of a pin. To the user it is one point with an angle; the server gets a short horizontal
// segment, centred at the rest position and turned about the posed one. Its weight times its length
// is the point mass, so its total weight is that of the point it replaces.

/**
 * Rest length of the segment, as a share of the mean side of the picture: it determines how far a
 * twist reaches.
 */
const SHARE = 1 / 8;
/**
 * The segment reaches this length in equal steps, one for each STEP degrees, so that the first
 * degree does not move the surroundings.
 */
const STEPS = 8;
const STEP = 2;
/** The server's lower limit of alpha with segments. */
export const LEAST_ALPHA = 0.5;

const RADIANS = Math.PI / 180;
/** @type {(degrees: number) => number} */
const tenth = (degrees) => Math.round(degrees * 10) / 10 + 0;
/**
 * The same angle in (-180, 180], as it is in a saved segment.
 * @type {(degrees: number) => number}
 */
const wrapped = (degrees) => tenth(180 - ((((180 - degrees) % 360) + 360) % 360));
/** @type {(handle: Page.Handle | undefined) => boolean} */
export const canTwist = (handle) => handle?.p.length === 1;
/** @type {(handle: Page.Handle) => number | null} */
export const angleOf = (handle) => handle.twist?.angle ?? null;

/**
 * Rotation in degrees and scale of a mesh at a rest position; of no use outside of the picture.
 * @param {Page.Mesh | null} mesh
 * @param {Page.Place} place
 * @param {number} reach
 * @returns {Page.Turn}
 */
export function freeTurn(mesh, [x, y], reach) {
  const [a, b] = [mesh?.forward(x - reach, y), mesh?.forward(x + reach, y)];
  if (!a || !b) return { angle: 0, scale: 1 };
  const [dx, dy] = [(b[0] - a[0]) / (2 * reach), (b[1] - a[1]) / (2 * reach)];
  const scale = Math.hypot(dx, dy);
  if (!(scale > 0.2 && scale < 5)) return { angle: 0, scale: 1 };
  return { angle: tenth(Math.atan2(dy, dx) / RADIANS), scale: Math.round(scale * 1000) / 1000 };
}

/** @type {(size: Page.Size) => number} */
export const longest = ([width, height]) =>
  Math.max(4, Math.round((width + height) * 0.5 * SHARE)) + 0.25;

/**
 * A pin turned to an angle. `free`: its angle and scale without a twist; at that angle it remains a
 * plain point.
 * @param {Page.Handle} handle
 * @param {number} degrees
 * @param {Page.Turn} free
 * @param {Page.Size} size
 * @returns {Page.Handle}
 */
export function turned(handle, degrees, free, size) {
  const angle = wrapped(degrees);
  const old = handle.twist;
  if (old)
    return old.angle === angle
      ? handle
      : { ...handle, twist: { ...old, ...grown(old, angle, size), angle } };
  if (angle === wrapped(free.angle)) return handle;
  const twist = { free: free.angle, scale: free.scale, length: 0 };
  return { ...handle, twist: { ...twist, ...grown(twist, angle, size), angle } };
}

/**
 * The length grows with the angle; it never shrinks, except within one drag, which always starts
 * from the same pin.
 * @param {{ free?: number, length: number }} twist
 * @param {number} angle
 * @param {Page.Size} size
 */
function grown({ free, length }, angle, size) {
  if (free === undefined) return { length };
  const steps = Math.min(STEPS, Math.ceil(Math.abs(wrapped(angle - free)) / STEP));
  return { length: Math.max(length, (longest(size) * Math.max(1, steps)) / STEPS) };
}

/**
 * @param {Page.Handle} handle
 * @returns {Page.Handle}
 */
export function untwisted({ twist: _, ...handle }) {
  return handle;
}

/**
 * The segment of a twisted pin: at rest (`p`), or posed (`q`).
 * @param {Page.Handle & { twist: Page.Twist }} handle
 * @param {Page.Which} which
 * @returns {Page.Place[]}
 */
export function segmentOf({ p, q, twist: { angle, scale, length } }, which) {
  const half = length / 2;
  if (which === "p") return [-half, half].map((off) => [p[0][0] + off, p[0][1]]);
  const [dx, dy] = [Math.cos(angle * RADIANS), Math.sin(angle * RADIANS)].map(
    (share) => share * half * scale,
  );
  return [-1, 1].map((side) => [fine(q[0][0] + side * dx), fine(q[0][1] + side * dy)]);
}

/** @type {(x: number) => number} */
const fine = (x) => Math.round(x * 1e4) / 1e4 + 0;

/**
 * The weight of the segment of a pin with this weight.
 * @type {(handle: { weight?: number, twist: Page.Twist }, mass: number) => number}
 */
export const segmentWeight = ({ weight = 1, twist }, mass) => (weight * mass) / twist.length;

/**
 * The pin of a saved segment, or null: horizontal at rest, with a weight that times its length is
 * the point mass.
 * @param {Page.Place[]} p
 * @param {Page.Place[]} q
 * @param {number | undefined} weight
 * @param {number | undefined} mass
 * @returns {Omit<Page.Handle, "id"> | null}
 */
export function pinOf(p, q, weight, mass) {
  if (
    p.length !== 2 ||
    q.length !== 2 ||
    p[0][1] !== p[1][1] ||
    mass === undefined ||
    !(mass > 0) ||
    weight === undefined ||
    weight === 1
  )
    return null;
  const length = p[1][0] - p[0][0];
  if (!(length > 0) || Math.abs((weight * length) / mass - 1) > 1e-6) return null;
  /** @type {(places: Page.Place[]) => Page.Place} */
  const middle = ([a, b]) => a.map((c, axis) => Math.round((c + b[axis]) * 50) / 100 + 0);
  const [dx, dy] = [q[1][0] - q[0][0], q[1][1] - q[0][1]];
  const scale = Math.round((Math.hypot(dx, dy) / length) * 1000) / 1000;
  return {
    p: [middle(p)],
    q: [middle(q)],
    twist: { angle: wrapped(Math.atan2(dy, dx) / RADIANS), scale, length },
  };
}
