// The table of methods of src/engine/deform/methods, written by tests/it/methods.rs.

/** @type {Page.MethodInfo[]} */
// prettier-ignore
export const METHODS = [
  {
    "handles": "all",
    "interpolates": true,
    "mesh": false,
    "name": "rigid",
    "object": false,
    "parameters": [
      {
        "default": 1.0,
        "name": "alpha",
        "sentence": "How quickly the influence of a handle falls off with distance."
      },
      {
        "default": 1.0,
        "name": "point_mass",
        "sentence": "The length of line that pulls as much as a point, in px."
      }
    ],
    "sentence": "Rotation and translation only, without scaling, like cardboard.",
    "title": "Rigid"
  },
  {
    "handles": "all",
    "interpolates": true,
    "mesh": false,
    "name": "similarity",
    "object": false,
    "parameters": [
      {
        "default": 1.0,
        "name": "alpha",
        "sentence": "How quickly the influence of a handle falls off with distance."
      },
      {
        "default": 1.0,
        "name": "point_mass",
        "sentence": "The length of line that pulls as much as a point, in px."
      }
    ],
    "sentence": "Allows scaling and keeps angles: use it to make something larger or smaller.",
    "title": "Similarity"
  },
  {
    "handles": "all",
    "interpolates": true,
    "mesh": false,
    "name": "affine",
    "object": false,
    "parameters": [
      {
        "default": 1.0,
        "name": "alpha",
        "sentence": "How quickly the influence of a handle falls off with distance."
      },
      {
        "default": 1.0,
        "name": "point_mass",
        "sentence": "The length of line that pulls as much as a point, in px."
      }
    ],
    "sentence": "Also allows stretching and shear: follows the handles most freely.",
    "title": "Affine"
  },
  {
    "handles": "points",
    "interpolates": "smoothing",
    "mesh": false,
    "name": "tps",
    "object": false,
    "parameters": [
      {
        "default": 0.0,
        "name": "smoothing",
        "sentence": "0 passes through the handles; more bends less and passes near them."
      }
    ],
    "sentence": "Bends the whole picture as little as it can, like a thin plate of metal.",
    "title": "Spline"
  },
  {
    "handles": "all",
    "interpolates": false,
    "mesh": false,
    "name": "global_affine",
    "object": false,
    "parameters": [
      {
        "default": 1.0,
        "name": "point_mass",
        "sentence": "The length of line that pulls as much as a point, in px."
      }
    ],
    "sentence": "Moves, turns, stretches and shears the whole picture as one: it passes near the handles, not through them.",
    "title": "Global"
  },
  {
    "handles": "lines",
    "interpolates": "a",
    "mesh": false,
    "name": "beier_neely",
    "object": true,
    "parameters": [
      {
        "default": 1.0,
        "name": "a",
        "sentence": "Softens the pull next to a line, in px; at 0 the lines are met exactly."
      },
      {
        "default": 2.0,
        "name": "b",
        "sentence": "How quickly the influence of a line falls off with distance."
      },
      {
        "default": 0.0,
        "name": "p",
        "sentence": "How much more longer lines pull; at 0 all pull alike."
      }
    ],
    "sentence": "Every line carries its surroundings along, as in the morphs of films. It stretches along a line and not across it, and reaches far.",
    "title": "Morph"
  },
  {
    "handles": "all",
    "interpolates": true,
    "mesh": true,
    "name": "arap",
    "object": true,
    "parameters": [
      {
        "default": null,
        "name": "cell",
        "sentence": "Side of the pieces of the mesh, in px; by default about 3000 of them cover the picture."
      }
    ],
    "sentence": "Poses a cut-out like a puppet of rubber: it follows the outline, and its pieces turn and keep their size where they can.",
    "title": "Puppet"
  }
];
