// JSON of what a caller gives.

/** Stands for a number that is not finite until the text is complete. */
const BEYOND = "mlswarp: a number that is not finite";

/**
 * JSON of a value. For NaN and infinities `JSON.stringify` writes null, which stands for an absent
 * value. Here they become a number beyond all ranges, which the service and the engine refuse with
 * the place where it stands.
 *
 * @param {unknown} value
 */
export function jsonOf(value) {
  const text = JSON.stringify(value, (_, member) =>
    typeof member !== "number" || Number.isFinite(member) ? member : BEYOND,
  );
  return text.replaceAll(`"${BEYOND}"`, "1e999");
}
