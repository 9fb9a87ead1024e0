// JSON with positions, for messages about a file: where it is broken, or where a value is.
// `JSON.parse` tells this in some browsers only.

import { known } from "./dom.js";

/** Nesting beyond which a file is rejected. */
const DEEPEST = 20;
const SPACE = /[ \t\r\n]*/y;
const NUMBER = /-?(?:0|[1-9]\d*)(?:\.\d+)?(?:[eE][+-]?\d+)?/y;
const STRING = /"(?:[^"\\\u0000-\u001f]|\\(?:["\\/bfnrt]|u[\da-fA-F]{4}))*"/y;
const WORD = /true|false|null/y;

/** A text that is not JSON. */
export class Broken extends Error {
  /**
   * @param {number} at
   * @param {string} expected
   */
  constructor(at, expected) {
    super(expected);
    this.at = at;
    this.expected = expected;
  }
}

/**
 * Line and column of an offset, from 1.
 * @param {string} text
 * @param {number} at
 */
export function lineAndColumn(text, at) {
  const lines = text.slice(0, at).split(/\r\n|\n|\r/);
  return { line: lines.length, column: known(lines.at(-1)).length + 1 };
}

/**
 * The value of a text, and the offset of each of its parts by JSON pointer. Throws `Broken`.
 * @param {string} text
 * @returns {{ value: Page.Json, places: Map<string, number> }}
 */
export function parse(text) {
  const places = new Map();
  let at = 0;
  /** @type {(pattern: RegExp) => string | undefined} */
  const take = (pattern) => {
    pattern.lastIndex = at;
    const [found] = pattern.exec(text) ?? [];
    if (found !== undefined) at += found.length;
    return found;
  };
  /** @type {(expected: string) => never} */
  const fail = (expected) => {
    throw new Broken(at, expected);
  };
  /**
   * The members of an array or object up to its end; `one` reads a member.
   * @type {(end: string, one: () => unknown) => unknown}
   */
  const members = (end, one) => {
    at += 1;
    take(SPACE);
    if (text[at] === end) return (at += 1);
    for (;;) {
      one();
      take(SPACE);
      if (text[at] === end) return (at += 1);
      if (text[at] !== ",") fail(`a comma or ${end}`);
      at += 1;
      take(SPACE);
    }
  };
  /** @type {(pointer: string, depth: number) => Page.Json} */
  const value = (pointer, depth) => {
    take(SPACE);
    if (depth > DEEPEST) fail("fewer brackets inside each other");
    places.set(pointer, at);
    if (text[at] === "[") {
      /** @type {Page.Json[]} */
      const list = [];
      members("]", () => list.push(value(`${pointer}/${list.length}`, depth + 1)));
      return list;
    }
    if (text[at] === "{") {
      const object = new Map();
      members("}", () => {
        const name = take(STRING);
        if (name === undefined) return fail("a name in double quotes");
        take(SPACE);
        if (text[at] !== ":") fail("a colon");
        at += 1;
        object.set(JSON.parse(name), value(`${pointer}/${JSON.parse(name)}`, depth + 1));
      });
      return Object.fromEntries(object);
    }
    const scalar = take(STRING) ?? take(NUMBER) ?? take(WORD);
    return scalar === undefined ? fail("a value") : JSON.parse(scalar);
  };
  const whole = value("", 0);
  take(SPACE);
  if (at < text.length) fail("the end of the file");
  return { value: whole, places };
}
