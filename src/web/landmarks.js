// Landmark files, which the server reads. Of a file with several specimens, images, persons or rows
// the user chooses one; a file that counts y from the lower edge needs the size of its picture.

import * as api from "./api.js";
import { find, text } from "./dom.js";
import { stem } from "./share.js";
import { ITEMS } from "./words.js";

/**
 * The picture that a landmark file belongs to.
 *
 * @typedef {{ name: string, size: () => Page.Size | Promise<Page.Size> }} OfPicture
 */

/** The items of a file: the names of each, as far as they are listed, and how many there are. */
/** @typedef {{ names: string[][], count: number }} Items */
/** @typedef {(file: string, items: Items, picture: string) => Item | Promise<Item>} Choose */
/** An item by its index or its name. @typedef {number | string} Item */

/** Only the picture that a file belongs to can answer what the server asks. */
export class NeedsPicture extends Error {}

/** @type {(problem: api.Problem) => boolean} */
const needsExtent = ({ code, detail }) => code === "bad_value" && /`extent_[pq]`/.test(detail);

/**
 * The index of the only item that has the name of a picture, with or without its ending; otherwise
 * -1.
 * @param {string[][]} items
 * @param {string} picture
 */
export function indexOfItem(items, picture) {
  const wanted = stem(picture);
  const found = items.flatMap((names, k) =>
    names.some((name) => name === picture || stem(name) === wanted) ? [k] : [],
  );
  return found.length === 1 ? found[0] : -1;
}

/**
 * Lets the user choose an item. Rejected with an `AbortError` if the dialog is closed without one.
 *
 * @type {Choose}
 */
export function chooseItem(file, { names: items, count }, picture) {
  const [dialog, list, other] = [find("item"), find("item-list"), find("item-other")];
  list.replaceChildren(...items.map((names, k) => new Option(ITEMS.label(names, k), String(k))));
  list.value = String(Math.max(0, indexOfItem(items, picture)));
  text("item-note", ITEMS.note(file, count, picture));
  other.value = "";
  find("item-more").hidden = count <= items.length;
  text("item-more-note", ITEMS.more(items.length));
  /** @type {() => Item} */
  const chosen = () => {
    const words = other.value.trim();
    const number = /^\d+$/.test(words) ? Number(words) : 0;
    return number >= 1 && number <= count ? number - 1 : words || Number(list.value);
  };
  find("item-form").onsubmit = () => dialog.close("use");
  list.ondblclick = () => dialog.close("use");
  find("item-close").onclick = find("item-cancel").onclick = () => dialog.close("");
  dialog.returnValue = "";
  dialog.showModal();
  return new Promise((resolve, reject) => {
    const end = () =>
      dialog.returnValue === "use"
        ? resolve(chosen())
        : reject(new DOMException("nothing chosen", "AbortError"));
    dialog.addEventListener("close", end, { once: true });
  });
}

/**
 * A landmark file as a warp object. Throws a Problem, or `NeedsPicture` if something is asked and
 * `picture` is null.
 * @param {File} file
 * @param {OfPicture | null} picture
 * @param {Choose} [choose]
 * @returns {Promise<Page.Landmarks>}
 */
export async function landmarksOf(file, picture, choose = chooseItem) {
  /** @type {{ item?: Item, extent?: Page.Size }} */
  const how = {};
  for (;;) {
    try {
      return await api.readLandmarks(file, how);
    } catch (error) {
      if (!(error instanceof api.Problem)) throw error;
      const names = how.item === undefined ? error.items : undefined;
      const asked = names && { names, count: error.item_count ?? names.length };
      if (!asked && !(needsExtent(error) && !how.extent)) {
        error.detail = error.detail.replace(/^landmarks, /, `In ${file.name}, `);
        throw error;
      }
      if (!picture) throw new NeedsPicture();
      if (asked) how.item = await choose(file.name, asked, picture.name);
      else how.extent = await picture.size();
    }
  }
}

/**
 * Two landmark files, one for each side. Throws as `landmarksOf`.
 * @param {File[]} files
 * @param {Blob[]} sides what of the files is read
 * @param {OfPicture | null} picture
 */
export async function sidesOf(files, sides, picture) {
  const read = [...sides];
  /** @type {Page.Size | undefined} */
  let extent;
  for (;;) {
    try {
      return await api.readSides(read[0], read[1], extent);
    } catch (error) {
      if (!(error instanceof api.Problem)) throw error;
      const k = error.detail.startsWith("landmarks_q") ? 1 : 0;
      if (error.items) {
        const { p, names, units } = await landmarksOf(files[k], picture);
        read[k] = new Blob([JSON.stringify({ p, names, units })]);
      } else if (needsExtent(error) && !extent) {
        if (!picture) throw new NeedsPicture();
        extent = await picture.size();
      } else throw error;
    }
  }
}
