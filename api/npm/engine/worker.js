// What runs in the worker of a WorkerEngine: an engine, and what was made with it, by number.

import { Engine, EngineCrashed, MlswarpError, Pose } from "./index.js";
import { Held } from "./instance.js";

/** @typedef {import("./worker-engine.js").Call} Call */
/** @typedef {import("./worker-engine.js").Answer} Answer */

/** @type {Map<number, any>} */
const held = new Map();
let last = 0;

/** @type {{ onmessage: unknown, postMessage(answer: Answer, transfer: Transferable[]): void }} */
const scope = /** @type {any} */ (globalThis);

/** @type {(value: any) => any} */
const part = (value) => (value?.heldByWorker ? held.get(value.heldByWorker) : value);

/** Images in a list, or the members of options. @type {(value: any) => any} */
function argument(value) {
  if (Array.isArray(value)) return value.map(part);
  if (value?.constructor !== Object || value.heldByWorker) return part(value);
  return Object.fromEntries(Object.entries(value).map(([name, one]) => [name, part(one)]));
}

/**
 * What is sent for a result, and the buffers that need not be copied.
 *
 * @param {any} result
 * @returns {[unknown, Transferable[]]}
 */
function sent(result) {
  if (result instanceof Held) {
    held.set(++last, result);
    return [{ number: last, report: result instanceof Pose ? result.report : undefined }, []];
  }
  const parts = [result, ...Object.values(result ?? {})];
  return [result, parts.filter(ArrayBuffer.isView).map((part) => /** @type {any} */ (part).buffer)];
}

scope.onmessage = async (/** @type {MessageEvent<Call>} */ { data }) => {
  const { id, on, method, given } = data;
  try {
    if (method === "load") held.set(0, await Engine.load(given[0]));
    if (method === "dispose") {
      held.get(on)?.dispose();
      held.delete(on);
    }
    const [result, transfer] =
      method === "load" || method === "dispose"
        ? [undefined, []]
        : sent(held.get(on)[method](...given.map(argument)));
    scope.postMessage({ id, result }, transfer);
  } catch (error) {
    /** @type {Answer} */
    const answer = { id, text: error instanceof Error ? error.message : String(error) };
    if (error instanceof MlswarpError) answer.problem = error.problem;
    answer.isCrash = error instanceof EngineCrashed;
    if (error instanceof Error && error.cause instanceof Error) answer.stack = error.cause.stack;
    scope.postMessage(answer, []);
  }
};
