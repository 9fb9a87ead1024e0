// What can go wrong: an answer of the server that is a problem document, or no answer.

/**
 * The members of a problem document (RFC 9457) that programs use; api/problems.md lists the codes.
 *
 * @typedef {import("./contract.js").Problem} Problem
 */

/**
 * Codes that say that a session is not there any more.
 *
 * @type {Set<string>}
 */
export const GONE = new Set(["session_expired", "no_such_session"]);

/** The server has answered with a problem document. Programs use `code`; texts may change. */
export class ApiError extends Error {
  /**
   * @param {Partial<Problem>} problem
   * @param {number} status
   * @param {string | null} requestId
   */
  constructor(problem, status, requestId) {
    super(problem.detail ?? problem.title ?? `the server answered ${status}`);
    this.name = "ApiError";
    /** Of the HTTP response; 0 for a problem of a drag that has none. */
    this.status = status;
    /** @type {Problem["code"]} */
    this.code = problem.code ?? "internal";
    this.detail = this.message;
    /** JSON pointer into the request. */
    this.pointer = problem.pointer;
    /** Index into `p` and `q`. */
    this.handle = problem.handle;
    this.limitName = problem.limit_name;
    this.limit = problem.limit;
    this.actual = problem.actual;
    /** Names the request in the log of the server. */
    this.requestId = requestId;
    /** Seconds. @type {number | undefined} */
    this.retryAfter = problem.retry_after;
    /** The document itself. */
    this.problem = problem;
  }

  /**
   * @param {Response} response
   * @returns {Promise<ApiError>}
   */
  static async from(response) {
    const text = await response.text();
    const requestId = response.headers.get("X-Request-Id");
    const error = new ApiError(problemIn(text, response.status), response.status, requestId);
    const header = Number(response.headers.get("Retry-After") ?? NaN);
    if (Number.isFinite(header)) error.retryAfter ??= header;
    return error;
  }
}

/**
 * @param {string} text
 * @param {number} status
 * @returns {Partial<Problem>}
 */
function problemIn(text, status) {
  try {
    const problem = JSON.parse(text);
    if (typeof problem?.code === "string") return problem;
  } catch {
    // It comes from a proxy, not from the service.
  }
  /** @type {Record<number, Problem["code"]>} */
  const codes = {
    401: "unauthorized",
    403: "forbidden",
    404: "not_found",
    408: "timeout",
    413: "too_large",
    429: "rate_limited",
    502: "unavailable",
    503: "overloaded",
    504: "timeout",
  };
  return {
    code: codes[status] ?? "internal",
    detail: `something between this client and the server answered ${status}: ${text.slice(0, 200)}`,
  };
}

/** No answer: the server cannot be reached, the connection broke, or the time was over. */
export class ConnectionFailed extends Error {
  /**
   * @param {"network" | "no_answer" | "closed"} code
   * @param {string} detail
   * @param {unknown} [cause]
   */
  constructor(code, detail, cause) {
    super(detail, { cause });
    this.name = "ConnectionFailed";
    /**
     * `network`: the connection could not be opened, or broke; `no_answer`: the time was over;
     * `closed`: the server has closed the socket of a drag for good.
     */
    this.code = code;
    this.detail = detail;
  }
}
