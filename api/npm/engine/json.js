// JSON of what a caller gives.

/** Stands for a number that is not finite until the text is complete. */
const BEYOND = "mlswarp: a number that is not finite";

/** @type {(name: string, member: unknown) => unknown} */
const marked = (_, member) =>
  typeof member !== "number" || Number.isFinite(member) ? member : BEYOND;

/**
 * GeoJSON has members that the service hands back unread: there it is null, as in any JSON.
 *
 * @type {(name: string, member: unknown) => unknown}
 */
const markedButGeojson = (name, member) =>
  name === "geojson" && member ? JSON.parse(JSON.stringify(member)) : marked(name, member);

/**
 * JSON of a value. For NaN and infinities `JSON.stringify` writes null, which stands for an absent
 * value. Here they become a number beyond all ranges, which the service and the engine refuse with
 * the place where it stands.
 *
 * @param {unknown} value
 */
export function jsonOf(value) {
  const text = JSON.stringify(value, marked);
  if (!text.includes(BEYOND)) return text;
  return JSON.stringify(value, markedButGeojson).replaceAll(`"${BEYOND}"`, "1e999");
}
