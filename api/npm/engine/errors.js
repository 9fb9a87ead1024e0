// What can go wrong: a wrong request, as the service would refuse it, or an engine that has ended.

/** A request that the service would refuse too, with the same code, sentence and place. */
export class MlswarpError extends Error {
  /** @param {Record<string, unknown>} problem the members of a problem document (RFC 9457) */
  constructor(problem) {
    super(String(problem.detail));
    this.name = "MlswarpError";
    /** The document itself. */
    this.problem = problem;
    /** As in api/problems.md; programs use it, because texts may change. */
    this.code = String(problem.code);
    this.detail = this.message;
    /** JSON pointer to the wrong value. */
    this.pointer = /** @type {string | undefined} */ (problem.pointer);
    /** Index into `p` and `q`. */
    this.handle = /** @type {number | undefined} */ (problem.handle);
    this.limitName = /** @type {string | undefined} */ (problem.limit_name);
    this.limit = problem.limit;
    this.actual = problem.actual;
  }
}

/**
 * The engine has ended by an error of its own, or for lack of memory, and everything that was made
 * with it is lost. `Engine.load` makes another one.
 */
export class EngineCrashed extends Error {
  /**
   * @param {string} text what the engine has said
   * @param {unknown} [cause] the trap, or its stack in a worker: it says where the file ended
   */
  constructor(text, cause) {
    super(text, { cause });
    this.name = "EngineCrashed";
  }
}
