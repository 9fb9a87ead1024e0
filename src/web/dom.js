// The elements of the page by their ids.

/**
 * @template {keyof PageElements} Id
 * @param {Id} id
 * @returns {PageElements[Id]}
 */
export const find = (id) =>
  /** @type {PageElements[Id]} */ (/** @type {unknown} */ (document.getElementById(id)));

/**
 * An element of a stage by its id: the stage of the page, or one in a shadow root.
 *
 * @template {keyof PageElements} Id
 * @param {Element} stage
 * @param {Id} id
 * @returns {PageElements[Id]}
 */
export const inStage = (stage, id) =>
  /** @type {PageElements[Id]} */ (/** @type {unknown} */ (part(stage, `#${id}`)));

/**
 * What the server has written into the page under a name.
 *
 * @param {string} name
 */
export const named = (name) =>
  /** @type {HTMLMetaElement} */ (document.querySelector(`meta[name=${name}]`)).content;

/**
 * A value that is there whenever this code runs.
 *
 * @template T
 * @param {T} value
 * @returns {NonNullable<T>}
 */
export function known(value) {
  if (value === null || value === undefined) throw new Error("a value is missing");
  return value;
}

/**
 * All elements for a selector.
 *
 * @param {string} selector
 * @returns {NodeListOf<HTMLElement>}
 */
export const findAll = (selector) => document.querySelectorAll(selector);

/**
 * The first element in another one for a selector, which has one there.
 *
 * @param {ParentNode} node
 * @param {string} selector
 * @returns {HTMLElement}
 */
export const part = (node, selector) =>
  /** @type {HTMLElement} */ (known(node.querySelector(selector)));

/**
 * The 2D context of a canvas, which every browser has.
 *
 * @param {HTMLCanvasElement} canvas
 * @param {CanvasRenderingContext2DSettings} [wish]
 */
export const contextOf = (canvas, wish) => known(canvas.getContext("2d", wish));

/**
 * Calls a function with the element after each event.
 *
 * @template {keyof PageElements} Id
 * @template {keyof HTMLElementEventMap} Name
 * @param {Id} id
 * @param {Name} name
 * @param {(node: PageElements[Id], event: HTMLElementEventMap[Name]) => unknown} act
 */
export function listen(id, name, act) {
  const node = find(id);
  /** @type {HTMLElement} */ (node).addEventListener(name, (event) => act(node, event));
}

/**
 * Sets a text, unless it is there already.
 *
 * @param {keyof PageElements} id
 * @param {string} words
 */
export function text(id, words) {
  const node = find(id);
  if (node.textContent !== words) node.textContent = words;
}
