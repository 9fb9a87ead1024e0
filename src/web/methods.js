// The table of methods of src/engine/deform/methods, written by tests/it/methods.rs.

/** @type {Page.MethodInfo[]} */
// prettier-ignore
export const METHODS = [
  {
    "name": "rigid",
    "title": "Rigid",
    "sentence": "x.",
    "handles": "all",
    "interpolates": true,
    "object": false,
    "parameters": []
  }
];
