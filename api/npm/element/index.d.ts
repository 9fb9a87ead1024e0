// The types of <mls-warp>. The class is bundled, so they are written by hand; a test compares them
// with it.

import type { Client } from "../types/client/index.js";
import type { Handle, WarpObject } from "../types/client/contract.js";

/** What `warpinput` and `warpchange` tell: the handles after a change by the person. */
export interface WarpDetail {
  /** Handles at rest, px of the picture. */
  p: Handle[];
  /** Posed handles, at full strength. */
  q: Handle[];
  /** The part of the way from `p` to `q` that is shown. */
  strength: number;
}

export interface MlsWarpEventMap extends HTMLElementEventMap {
  /** The first picture is shown. */
  warpready: CustomEvent<WarpDetail>;
  /** A handle is being dragged. */
  warpinput: CustomEvent<WarpDetail>;
  /** A drag has ended, or handles were added, deleted, nudged, undone. Not for what the site sets. */
  warpchange: CustomEvent<WarpDetail>;
  /**
   * Something went wrong: an `ApiError` or `ConnectionFailed` of `mlswarp/client`, an error of
   * `mlswarp/engine`, or one of the browser.
   */
  warperror: CustomEvent<Error>;
}

/** `empty` has no picture; `ready` shows the exact picture of the pose. */
export type WarpState = "empty" | "loading" | "busy" | "ready" | "error";

/** A picture whose handles can be dragged. */
export class MlsWarp extends HTMLElement {
  static readonly observedAttributes: string[];
  /** The address of the picture: the attribute. */
  src: string;
  /** The address of the server: the attribute. Without one, the engine warps in a worker. */
  server: string;
  /** The id of the session that is used: the attribute. For a token, the one that it is for. */
  session: string;
  /** Whether it only shows the warped picture: the attribute. */
  readonly: boolean;
  /** The client that it uses, in place of `server`: with a key or a function that gets tokens. */
  get client(): Client | null;
  set client(client: Client | null);
  /** The picture: a file, a bitmap, pixels or an address; `src`, unless it was set. */
  get image(): Blob | ImageBitmap | ImageData | string | URL | null;
  set image(image: Blob | ImageBitmap | ImageData | string | URL | null);
  /** Handles at rest, px of the picture. Setting them keeps `q` if it fits. */
  get p(): Handle[];
  set p(p: readonly Handle[]);
  /** Posed handles, at full strength. */
  get q(): Handle[];
  set q(q: readonly Handle[]);
  /** Handles and settings: a warp object, which the server takes as it is. */
  get warp(): WarpObject;
  set warp(warp: WarpObject);
  /** `rigid`, `similarity`, `affine`, `tps`, `global_affine`, `arap` or `beier_neely`. `arap` needs a server. */
  method: string;
  /** How quickly the influence of a handle falls off. Null: automatic. */
  get alpha(): number;
  set alpha(alpha: number | null);
  /** The part of the way from `p` to `q` that is shown. A change by the person ends it. */
  strength: number;
  /** What a click at an empty position makes: `point`, `line` or `path`. */
  tool: string;
  /** What is shown. */
  readonly state: WarpState;
  /** The largest distance between a handle and where it is shown, px; null if it is not known. */
  readonly residual: number | null;
  /** The warped picture as a file: the bytes of the server. `quality`: of a JPEG, 0 to 1. */
  toBlob(type?: string, options?: { width?: number; quality?: number }): Promise<Blob>;
  undo(): void;
  redo(): void;
  /** Shows the whole picture, or `zoom` CSS px for each pixel of the picture. */
  zoomTo(zoom: "fit" | number): void;
  /** Moves the focus to a handle. */
  focusHandle(index: number): void;

  addEventListener<Name extends keyof MlsWarpEventMap>(
    type: Name,
    listener: (this: MlsWarp, event: MlsWarpEventMap[Name]) => unknown,
    options?: boolean | AddEventListenerOptions,
  ): void;
  addEventListener(
    type: string,
    listener: EventListenerOrEventListenerObject,
    options?: boolean | AddEventListenerOptions,
  ): void;
}

declare global {
  interface HTMLElementTagNameMap {
    "mls-warp": MlsWarp;
  }
}
