// The page in a frame of another site. That site gets a session token from its own server and hands
// it over by a message; the page asks for another when it has expired. Only the sites that the
// server lists (--frame-ancestors) are listened to. A token is kept in memory alone.

import { useToken } from "./access.js";
import { named } from "./dom.js";

/** The messages: of the page, that it listens and that its token has expired; of the site. */
const READY = "mlswarp-ready";
const EXPIRED = "mlswarp-token-expired";
const TOKEN = "mlswarp-token";

const ancestors = named("frame-ancestors").split(" ");

/** @type {(origin: string) => boolean} */
const isAncestor = (origin) => ancestors.includes("*") || ancestors.includes(origin);

/**
 * Tells the site something that anybody may know.
 *
 * @param {string} type
 */
function tell(type) {
  if (parent !== window) parent.postMessage({ type }, "*");
}

/**
 * Listens for `{ type: "mlswarp-token", token, image?, name? }`: `image` is a Blob that is opened.
 *
 * @param {(image: File | null) => void} taken
 */
export function listenToSite(taken) {
  addEventListener("message", ({ source, origin, data }) => {
    if (parent === window || source !== parent || !isAncestor(origin)) return;
    if (data?.type !== TOKEN || !useToken(data.token)) return;
    const { image, name } = data;
    const isImage = image instanceof Blob;
    taken(isImage ? new File([image], String(name ?? "picture"), { type: image.type }) : null);
  });
  tell(READY);
}

export const askForToken = () => tell(EXPIRED);
