// The engine and the client: nothing here touches the page.

export { ApiError, Client, ConnectionFailed, Drag, Session } from "./client/index.js";
export * from "./engine/index.js";
