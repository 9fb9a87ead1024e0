// What the examples on this page share: the address of the server, the API key, and a place for
// results. The page passes the place.

export { keyHeaders as headers, keyProtocols as protocols } from "../../page/access.js";

/** The address of this server, with a slash at the end; a proxy may serve it under any path. */
export const server = new URL("../../", import.meta.url).href;

/** @type {Element} */
let place;
/** @type {(element: Element) => void} */
export const showIn = (element) => {
  place = element;
};

/**
 * Shows a response, a Blob with a picture, or a value as JSON.
 * @param {unknown} result
 * @param {string} [caption]
 */
export async function show(result, caption = "") {
  const to = place;
  if (result instanceof Response) {
    caption = [caption, `${result.status}`, result.headers.get("Warp-Warning")]
      .filter(Boolean)
      .join(" - ");
    const isPicture = result.headers.get("Content-Type")?.startsWith("image/");
    result = isPicture ? await result.blob() : await result.json();
  }
  const figure = document.createElement("figure");
  if (result instanceof Blob) {
    const image = new Image();
    image.src = URL.createObjectURL(result);
    image.alt = caption || "the result";
    await image.decode();
    figure.append(image);
  } else {
    const text = document.createElement("pre");
    text.textContent = JSON.stringify(result, null, 1).replace(/\n\s+(?=[-\d\]])/g, " ");
    text.tabIndex = 0;
    figure.append(text);
  }
  if (caption)
    figure.append(Object.assign(document.createElement("figcaption"), { textContent: caption }));
  to.append(figure);
}
