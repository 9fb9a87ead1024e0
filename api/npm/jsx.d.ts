// The types of <mls-warp> in JSX. Preact and Solid find them in the global namespace. For React:
//
//     import type { WarpElements } from "mlswarp/jsx";
//
//     declare module "react" {
//       namespace JSX {
//         interface IntrinsicElements extends WarpElements {}
//       }
//     }

import type { MlsWarp, MlsWarpEventMap } from "./element/index.js";

type Listener<Name extends keyof MlsWarpEventMap> = (event: MlsWarpEventMap[Name]) => void;

/** Properties are set as such; the attributes of HTML are those of the framework. */
export interface WarpProps extends Partial<
  Pick<
    MlsWarp,
    | "src"
    | "server"
    | "session"
    | "readonly"
    | "client"
    | "image"
    | "p"
    | "q"
    | "warp"
    | "method"
    | "alpha"
    | "strength"
    | "tool"
  >
> {
  onwarpready?: Listener<"warpready">;
  onwarpinput?: Listener<"warpinput">;
  onwarpchange?: Listener<"warpchange">;
  onwarperror?: Listener<"warperror">;
  ref?: unknown;
  key?: string | number;
  id?: string;
  style?: unknown;
  className?: string;
  class?: string;
  "aria-label"?: string;
}

export interface WarpElements {
  "mls-warp": WarpProps;
}

declare global {
  namespace JSX {
    interface IntrinsicElements extends WarpElements {}
  }
}
