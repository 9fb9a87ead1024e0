// Registers <mls-warp>. Without a DOM it does nothing.

import { MlsWarp } from "./index.js";

if (globalThis.customElements && !customElements.get("mls-warp"))
  customElements.define("mls-warp", MlsWarp);
