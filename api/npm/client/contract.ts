// The objects of api/openapi.json. `node contract.mjs` writes this file.

/**
 * What a session token allows; see `POST /sessions/{id}/tokens`.
 */
export type TokenOperation = "read" | "warp" | "drag" | "handles" | "layers" | "upload" | "batch" | "delete";

export type SessionToken = {
  /**
   * Three parts of base64url with dots between.
   */
  token: string;
  expires: string;
  ops: TokenOperation[];
};

/**
 * Before anything else, each `q` is mapped from its own frame to that of `p` by the best map
 * of this class: least squares in px over the points and 9 equidistant positions of each
 * segment, with the weights of the handles. Only `affine` may mirror. With too few handles
 * the next smaller class is used, down to a translation: `affine` needs handles that do not
 * lie on one line, and `rigid` and `similarity` two positions, in `p` and in `q`. Reports
 * have the map. So two shapes of different place, turn and size can be compared; `strength`
 * counts after it. A session aligns each `q` that it is sent, also a binary one; the
 * coefficients of `/plan` are for aligned positions.
 */
export type Align = "none" | "rigid" | "similarity" | "affine";

/**
 * How much of the way from `p` to `q` the handles are moved: to `p + strength (q - p)`. 0 is
 * the image at rest; values above 1 exaggerate the movement and negative ones reverse it. A
 * session keeps it with its `q`; a request without `q` may give another one. Without any
 * `q`, a strength other than 1 is rejected.
 */
export type Strength = number;

/**
 * `[x, y]`. See "Coordinates" in the description of this document.
 */
export type Place = [number, number];

/**
 * A line segment (two points) or a polyline (three or more points). At rest no segment may
 * have zero length.
 */
export type Line = Place[];

/**
 * A point or a line; a set may contain both kinds. `null`: the handle is missing, such as a
 * landmark that is not visible. A handle that is missing in `p` or in `q` is left out on
 * both sides, keeps its index everywhere, and causes the warning `handles_missing`. In a
 * session, `q` may only miss handles that `p` misses too.
 */
export type Handle = Place | Line | null;

/**
 * The handles at rest. An empty set gives the identity.
 */
export type HandlesAtRest = Handle[];

/**
 * The posed handles, in the order and shape of `p`. A request about a session may leave them
 * out if the session has a pose of its own: one that was created with `q` or with landmark
 * files of both sides.
 */
export type PosedHandles = Handle[];

/**
 * One factor per handle, multiplied with the handle's weight. Default 1. With `tps` it
 * divides the handle's `smoothing`, and has no effect without.
 */
export type Weights = number[];

/**
 * One number per handle, default 0. Where the posed image overlaps itself, cells of more
 * depth lie in front: a leg in front of another, a hand in front of the body. The depth of a
 * cell is the mean of its vertices, and that of a vertex the mean of the handles by their
 * weights there (with `tps`, `global_affine` and `beier_neely` what the map makes of them,
 * with `arap` as smooth as the mesh allows). Cells of one depth are drawn row by row, as
 * without depths. Labels, coverage, `/map` and the inverse of `/points` follow the same
 * order. Depths belong to the handles at rest: before a drag, a client sends `PUT
 * /sessions/{id}/handles` with `depth` alone, the largest for the handles in hand.
 */
export type Depth = number[];

/**
 * As `EffectiveMethod`; `auto` chooses the method and its parameters that predict handles
 * best from the others, as `POST /fit` does. It needs `q` and 4 to 2,000 points, and takes
 * neither `alpha` nor `smoothing`. The choice is made once: a session keeps it, and drags do
 * not choose again. The response of `POST /warp` names it (`Warp-Method`).
 */
export type Method = "rigid" | "similarity" | "affine" | "tps" | "global_affine" | "beier_neely" | "arap" | "auto";

/**
 * `rigid`, `similarity` and `affine`: the class of maps that moving least squares fits at
 * every point. `tps`: the thin-plate spline, for points only; of all maps through the posed
 * handles it bends least. It has no `alpha` and no `point_mass`, and at most 2,000 handles.
 * `global_affine`: one affine map, of least squares over all handles, which it does not meet
 * exactly; it has no `alpha`. `beier_neely`: field morphing (Beier, Neely 1992), forwards,
 * for lines only; it has no `alpha` and no `point_mass`, and its parameters are in the
 * object `beier_neely`. `arap`: as rigid as possible (Igarashi, Moscovich, Hughes 2005), on
 * a mesh of what the image shows, which follows its outline: the pixels of `mask`. It needs
 * an image: `/points`, `/map` and `/report` outside of a session answer `not_supported`. It
 * has no `alpha`, no `point_mass`, no `grid` other than `auto`, and no table (`no_table`);
 * its parameter is in the object `arap`. A handle more than 3 px beside the mask is refused;
 * a part with one handle moves as a whole, and one without stays.
 */
export type EffectiveMethod = "rigid" | "similarity" | "affine" | "tps" | "global_affine" | "beier_neely" | "arap";

/**
 * The exponent of the weight 1/|p - v|^(2 alpha): how quickly a handle's influence falls off
 * with distance. At least 0.5 in a set with lines. Default 1 for points alone, 2 with any
 * line. Not with `tps`, `global_affine`, `beier_neely`, `arap` and `auto`.
 */
export type Alpha = number;

/**
 * Parameters of the method `beier_neely`. A line of length L at distance d from a position
 * weighs (L^p / (a + d))^b. An object replaces the former one as a whole.
 */
export type BeierNeely = {
  /**
   * Softens the pull next to a line, px. At 0 the lines are met exactly; above it f passes
   * near them.
   */
  a?: number;
  /**
   * How quickly the influence of a line falls off with distance.
   */
  b?: number;
  /**
   * How much more longer lines pull; at 0 all pull alike.
   */
  p?: number;
};

/**
 * Parameters of the method `arap`. An object replaces the former one as a whole.
 */
export type Arap = {
  /**
   * Side of the cells of the mesh, px. By default 4 to 32, so that about 3,000 of them cover
   * what the image shows. The mesh has at most 60,000 vertices (`too_many_vertices`).
   */
  cell?: number;
};

/**
 * The mass of a point in a set of points and lines, px. Default: the mean length of the
 * segments. Not with `tps`, `beier_neely` and `arap`.
 */
export type PointMass = number;

/**
 * With `tps` only. 0, the default: the result goes through the posed handles. More: it
 * passes near them and bends less, towards the one affine map that fits them best. The unit
 * is that of coordinates whose root mean square distance from their mean is 1: values from
 * 0.001 to 0.1 suit measured landmarks at any size.
 */
export type Smoothing = number;

/**
 * The treatment of handles that coincide at rest: rounded landmarks, contours that cross.
 * Points nearer to each other than `within`, directly or by way of others, are one handle:
 * its rest position and its target are their weighted means, its weight is their sum. Lines
 * that cross or touch, and points on lines, stay handles of their own; the position that
 * they share moves by the weighted mean of their displacements. If the displacements at a
 * position differ, `Warp-Warning` is `coincident_handles` with the policy `mean`, and the
 * request is refused with `contradictory_handles` with the policy `reject`.
 */
export type Coincident = {
  policy?: "mean" | "reject";
  /**
   * px; at least a billionth of the extent of the handles is used.
   */
  within?: number;
};

/**
 * The unit of `p`, `q` and `points`: pixels of the source image, or x/W and y/H.
 */
export type Units = "px" | "normalized";

/**
 * The grid on which the deformation is computed before rendering. With a tolerance, the
 * rendered image differs from the exact deformation by at most that many pixels of the
 * source at every pixel and at every handle: cells of a size that depends on the image size
 * are divided into smaller ones where necessary, down to 0.5 px. `auto` is a tolerance of
 * 0.25. Where even those differ more (next to points where a rotation is undefined, or
 * handles that contradict each other), the response has the warning `tolerance_exceeded`. A
 * cell size in px, a number of vertices, and `pixel`, a vertex at every pixel corner, are
 * used as they are. Meshes and `Warp-Folds` refer to the undivided grid, and previews of a
 * drag socket use it.
 */
export type Grid = "auto" | "pixel" | {
  tolerance: number;
} | {
  cell: number;
} | {
  columns: number;
  rows: number;
};

/**
 * If the posed grid folds: render it and count the cells (`report`), reject the request (422
 * `folded`), or `remove` the folds: then another map without folds takes the handles to the
 * same places, and the whole of the image follows it. Where nothing folds, and nothing
 * nearly folds, `remove` is the same as `report`, to the bit. `remove` is for `rigid`,
 * `similarity`, `affine`, and `tps` without `smoothing`, with the metric `euclidean` (else
 * 422 `not_supported`). The map in the image is then what the grid draws, for `/points`,
 * labels and the inverse too: its cells are not divided. 422 `unreachable` names handles
 * that would have to pass through each other, or through themselves; the warning
 * `folds_remain` counts cells that still fold, or cover others at the border. It takes some
 * milliseconds to some tens of them for each pose. A fold is a cell whose orientation
 * differs from that of most of the image; an exact mirror image has none.
 */
export type Folds = "report" | "reject" | "remove";

/**
 * The compression effort of PNG and TIFF.
 */
export type Compression = "fast" | "none" | "best";

/**
 * How the source is interpolated between pixel centres; `bicubic` is Catmull-Rom. Where the
 * warp shrinks the source by more than 1.5, `bilinear` and `bicubic` average the part of the
 * source that each pixel shows.
 */
export type Filter = "bilinear" | "nearest" | "bicubic";

/**
 * The content outside the posed image: transparent, the nearest edge pixels (`edge`), the
 * source mirrored at the posed border (`reflect`, outermost pixels repeated), or a solid
 * colour. The `value` of an object is an opaque colour in units of the image's depth: up to
 * 255 with 8 bits, 65,535 with 16; one number is a grey. It does not apply to labels, whose
 * outside is 0.
 */
export type Outside = "transparent" | "edge" | "reflect" | string | {
  value: number | [number, number, number];
};

/**
 * The part of the posed plane that is rendered. `same` is the rectangle of the source. `fit`
 * is the smallest box of whole pixels that contains the whole result; with a region that is
 * the source and all cells of the grid that the region touches. An object is a box in pixels
 * of the source; it may lie partly or entirely outside the source. A canvas inside a larger
 * one of the same scale is an exact crop of it, pixel for pixel, so tiles can be put
 * together. The response has the header `Warp-Canvas` unless it is `same`.
 */
export type Canvas = "same" | "fit" | {
  /**
   * Left edge.
   */
  x: number;
  /**
   * Upper edge.
   */
  y: number;
  width: number;
  height: number;
};

/**
 * What is shown where content of a region moved away and nothing covers the place: the
 * source (`keep`), or nothing (`transparent`). Without a region it has no effect. Let S be
 * the source at rest, with what `outside` puts beyond it, M the source warped, and m and r
 * the mask warped and at rest, 0 to 1 (m is 0 where the warped image is not). Each pixel is
 * m M + k S, in colours times alpha, with k = 1 - m for `keep` and k = min(1 - m, 1 - r) for
 * `transparent`. Where m (and r) is 0 it is the source, bit for bit; where m is 1 it is the
 * warp without a region.
 */
export type Holes = "keep" | "transparent";

/**
 * The form of the result. In a drag, given fields override those of the session for this
 * image.
 */
export type Output = {
  /**
   * PNG, WebP and TIFF are lossless. PNG and TIFF have the depth of the source, WebP and JPEG
   * 8 bit. A grey source gives a grey picture, except in WebP or with a colour `outside` that
   * is not grey. JPEG has no alpha channel: transparent pixels are flattened onto the colour
   * `outside`, or onto white. If the request has no `format`, `Accept` determines it.
   */
  format?: "png" | "jpeg" | "webp" | "tiff";
  /**
   * JPEG quality: higher is more exact and larger. The steps of quantisation are those of
   * libjpeg.
   */
  quality?: number;
  /**
   * Chroma subsampling of a JPEG: `4:2:0` stores the colours at half of the picture's width
   * and height, `4:4:4` at full size. Brightness is always stored at full size. Default:
   * `4:2:0` below quality 90, `4:4:4` otherwise.
   */
  subsampling?: "4:2:0" | "4:4:4";
  compression?: Compression;
  /**
   * Width of the result, px: the canvas at another size. Default: the width of the canvas. The
   * height keeps the aspect ratio.
   */
  width?: number;
  filter?: Filter;
  outside?: Outside;
  canvas?: Canvas;
  holes?: Holes;
};

/**
 * How the distance of a handle is measured, with which its influence falls off, for `rigid`,
 * `similarity` and `affine`. `euclidean`: in the plane. `geodesic`: along the shortest path
 * inside what the image shows (its alpha, times the region if there is one), so that a leg
 * bends without its neighbour. Handles have no influence on parts that no path from them
 * reaches: a part without handles stays where it is, one with one handle is moved by it.
 * `alpha` is 2 unless it is given. If every pixel belongs to the mask, both are the same,
 * and the warning `mask_is_everything` says so. Without an image (`/points`, `/map`,
 * `/report`) 422 `not_supported`.
 */
export type Metric = "euclidean" | "geodesic";

/**
 * What belongs to the mask of the metric `geodesic` and the method `arap`: pixels whose
 * alpha, times the region if there is one, is above this share of full alpha. Other visible
 * pixels go with the nearest of these that they touch, themselves or through others; those
 * that touch none stay where they are.
 */
export type Mask = {
  threshold?: number;
};

/**
 * A warp object. `p` and `q` belong together: without `p` the image is unchanged, and with
 * `p`, `/warp` and `/points` need `q`. Every other field has a default.
 */
export type WarpObject = {
  p?: HandlesAtRest;
  q?: PosedHandles;
  align?: Align;
  strength?: Strength;
  weights?: Weights;
  depth?: Depth;
  method?: Method;
  alpha?: Alpha;
  point_mass?: PointMass;
  smoothing?: Smoothing;
  beier_neely?: BeierNeely;
  metric?: Metric;
  mask?: Mask;
  arap?: Arap;
  coincident?: Coincident;
  units?: Units;
  grid?: Grid;
  folds?: Folds;
  output?: Output;
  names?: HandleNames;
  format?: LandmarkFormat;
  unmatched?: Unmatched;
  match?: LandmarkMatch;
  item?: LandmarkItem;
};

/**
 * A number that increases with every step of a drag; the newest wins. It counts as seen once
 * the body is read, even if the pose is then rejected.
 */
export type Seq = number;

/**
 * One step of a drag.
 */
export type Drag = {
  q?: PosedHandles;
  strength?: Strength;
  seq?: Seq;
  layer?: LayerRef;
  output?: Output;
};

/**
 * Draws this layer of the session instead of its image, through the same coefficients.
 * `@coverage` shows how much of each pixel the posed image covers, and `@holes` where
 * content of the region moved away and nothing covers the place, both from 0 to 255. A layer
 * of labels cannot be drawn as JPEG or WebP. If neither `output.format` nor `Accept`
 * requests a format, labels and the built-in layers are PNG, or TIFF if the output of the
 * session is TIFF.
 */
export type LayerRef = string;

/**
 * Points, in the unit of the handles. `null` stays `null`: a point that is missing.
 */
export type Places = (Place | null)[];

/**
 * Rings: the last vertex is connected with the first. In the unit of the handles. `null` in
 * the place of a ring stays `null`; a vertex is not `null`.
 */
export type Polygons = (Place[] | null)[];

/**
 * `[left, top, right, bottom]`. A mapped box is the bounding box of the mapped outline.
 */
export type Box = [number, number, number, number];

/**
 * Boxes, in the unit of the handles. `null` stays `null`.
 */
export type Boxes = (Box | null)[];

/**
 * x and y, in the unit of the handles; further numbers, such as a height, stay as they are.
 */
export type GeoPosition = [number, number];

/**
 * A position, or an empty array: a point without a position.
 */
export type GeoPoint = [number, number];

/**
 * A GeoJSON geometry (RFC 7946).
 */
export type Geometry = {
  type: "Point";
  coordinates: GeoPoint;
} | {
  type: "MultiPoint";
  coordinates: GeoPosition[];
} | {
  type: "LineString";
  coordinates: GeoPosition[];
} | {
  type: "MultiLineString";
  coordinates: GeoPosition[][];
} | {
  type: "Polygon";
  coordinates: GeoPosition[][];
} | {
  type: "MultiPolygon";
  coordinates: GeoPosition[][][];
} | {
  type: "GeometryCollection";
  geometries: CollectedGeometry[];
};

/**
 * A geometry of a GeometryCollection, which may be a collection itself.
 */
export type CollectedGeometry = Record<string, unknown>;

/**
 * A GeoJSON feature. Every member that is a geometry is mapped, whatever its name, such as
 * the `nucleusGeometry` of QuPath, and so is every such member of `properties`. Everything
 * else is returned as it is.
 */
export type Feature = {
  type: "Feature";
  geometry?: Geometry | null;
  properties?: Record<string, unknown> | null;
};

/**
 * GeoJSON (RFC 7946): a FeatureCollection, a list of features, one Feature, or one geometry;
 * the response has the same shape, ids, properties and order. `bbox` members are computed
 * again; that of a FeatureCollection follows its features. A vertex that is added to a line
 * with heights has a height between those of its neighbours.
 */
export type GeoJson = {
  type: "FeatureCollection";
  features: GeoObject[];
} | GeoObject[] | GeoObject;

/**
 * A GeoJSON feature or geometry.
 */
export type GeoObject = Feature | Geometry;

/**
 * A complete warp object, the size of the image, and annotations to map.
 */
export type Points = {
  p?: HandlesAtRest;
  q?: PosedHandles;
  align?: Align;
  strength?: Strength;
  weights?: Weights;
  depth?: Depth;
  method?: Method;
  alpha?: Alpha;
  point_mass?: PointMass;
  smoothing?: Smoothing;
  beier_neely?: BeierNeely;
  metric?: Metric;
  mask?: Mask;
  arap?: Arap;
  coincident?: Coincident;
  units?: Units;
  grid?: Grid;
  folds?: Folds;
  output?: Output;
  names?: HandleNames;
  format?: LandmarkFormat;
  unmatched?: Unmatched;
  /**
   * Width and height of the image, px.
   */
  extent: [number, number];
  points?: Places;
  polygons?: Polygons;
  boxes?: Boxes;
  geojson?: GeoJson;
  /**
   * Map from posed positions, those of the picture, to those at rest.
   */
  inverse?: boolean;
  /**
   * Add vertices to polygons, lines and rings where the map bends their edges by more than 0.1
   * px of the image of the result.
   */
  refine?: boolean;
};

/**
 * A pose of a session and annotations to map.
 */
export type PosedPoints = {
  q?: PosedHandles;
  strength?: Strength;
  output?: Output;
  points?: Places;
  polygons?: Polygons;
  boxes?: Boxes;
  geojson?: GeoJson;
  /**
   * Map from posed positions, those of the picture, to those at rest.
   */
  inverse?: boolean;
  /**
   * Add vertices to polygons, lines and rings where the map bends their edges by more than 0.1
   * px of the image of the result.
   */
  refine?: boolean;
};

/**
 * A complete warp object and the size of the image. Of `output`, `canvas` and `width` say
 * which picture the response is about.
 */
export type Report = {
  p?: HandlesAtRest;
  q?: PosedHandles;
  align?: Align;
  strength?: Strength;
  weights?: Weights;
  depth?: Depth;
  method?: Method;
  alpha?: Alpha;
  point_mass?: PointMass;
  smoothing?: Smoothing;
  beier_neely?: BeierNeely;
  metric?: Metric;
  mask?: Mask;
  arap?: Arap;
  coincident?: Coincident;
  units?: Units;
  grid?: Grid;
  folds?: Folds;
  output?: Output;
  names?: HandleNames;
  format?: LandmarkFormat;
  unmatched?: Unmatched;
  /**
   * Width and height of the image, px.
   */
  extent: [number, number];
};

/**
 * A pose of a session. Of `output`, `canvas` and `width` say which picture the response is
 * about.
 */
export type PosedReport = {
  q?: PosedHandles;
  strength?: Strength;
  output?: Output;
};

export type Summary = {
  min: number;
  median: number;
  max: number;
};

/**
 * Figures of a pose. A number that would not be finite is null.
 */
export type ReportAnswer = {
  /**
   * For each handle, the largest distance in px between its posed position and where the drawn
   * image has its rest position; null if it rests outside the image or is missing. A line is
   * measured at five positions of each segment. `Warp-Residual` differs where handles
   * contradict each other, and with methods that do not interpolate, for which it is relative
   * to the map.
   */
  residuals: (number | null)[];
  /**
   * Cells of the grid that fold: their orientation is not that of most of the image.
   */
  folds: {
    /**
     * Their number, as in `Warp-Folds`.
     */
    cells: number;
    /**
     * Their share of the area of the image at rest, 0 to 1.
     */
    share: number;
    /**
     * The number of groups of cells that share an edge or a corner.
     */
    regions: number;
    /**
     * The posed boxes, [left, top, right, bottom] in pixels of the picture, of the 100 largest
     * groups.
     */
    boxes: ([number | null, number | null, number | null, number | null])[];
    /**
     * What was done to remove folds; absent where none were.
     */
    removed?: {
      /**
       * The number of maps whose product is drawn.
       */
      factors: number;
      /**
       * Cells that fold if folds are not removed.
       */
      cells: number;
      /**
       * Cells that the product folds, or nearly, so that their vertices and those around them are
       * moved.
       */
      mended: number;
    };
  };
  /**
   * Whether most of the image, by its area at rest, is turned over.
   */
  mirrored: boolean;
  /**
   * Posed area over area at rest, over the cells of the grid: the determinant of the mean
   * Jacobian of the cell. Negative where the cell is turned over, so everywhere in a mirror
   * image.
   */
  area_factor: Summary | null;
  /**
   * The largest change of a right angle in a cell, in degrees: 90 - 2 atan(s2 / s1), where s1
   * >= |s2| are the singular values of its mean Jacobian, s2 with the sign of the determinant,
   * or the opposite one if the image is `mirrored`. 0 is a rotation with a uniform scale, also
   * of a mirror image, 90 is flattened to a line, and more is turned over against the whole.
   */
  shear: Summary | null;
  /**
   * The canvas in px of the source; null if `fit` has nothing to show.
   */
  canvas: {
    x: number;
    y: number;
    width: number;
    height: number;
  } | null;
  /**
   * Width of the picture that `output` asks for, px; null without a canvas.
   */
  width: number | null;
  /**
   * Its height, px; null without a canvas.
   */
  height: number | null;
  /**
   * px of the picture in a px of the source, along x and y; null without a canvas.
   */
  scale: [number, number] | null;
  /**
   * The share of the canvas that the posed image covers, 0 to 1: counted at the pixel centres,
   * or of a canvas with more than 1024 px a side at 1024 equal steps.
   */
  covered: number;
  /**
   * Whether the drawn image is within the tolerance of the grid; null if the grid has none.
   */
  tolerance: {
    px: number;
    met: boolean;
    /**
     * Cells of the grid that are farther from the exact map.
     */
    exceeded: number;
  } | null;
  /**
   * The first 100 groups of handles that coincide at rest and move differently.
   */
  coincident: {
    handles: number[];
    /**
     * Where they rest, px of the source.
     */
    position: [number, number];
    /**
     * The largest difference from the mean displacement, px.
     */
    spread: number;
  }[];
  /**
   * The distances in px between positions of the image and the inverse of their images, over a
   * lattice of at most 32 x 32 positions.
   */
  round_trip: {
    /**
     * The number of positions that are measured.
     */
    positions: number;
    /**
     * Positions that are left out: in or beside folded cells, or covered by another part of the
     * image.
     */
    in_folds: number;
    /**
     * Positions whose images have no inverse.
     */
    missing: number;
    median: number | null;
    max: number | null;
  };
  /**
   * The map by which `q` was aligned; null if none was requested.
   */
  align: {
    /**
     * A smaller one than requested if the handles do not determine that.
     */
    class: "translation" | "rigid" | "similarity" | "affine";
    /**
     * Two rows [a, b, c]: x' = a x + b y + c, from the frame of `q` to that of `p`, px.
     */
    matrix: [[number | null, number | null, number | null], [number | null, number | null, number | null]];
  } | null;
  /**
   * The warnings of the header `Warp-Warning`, in its order, with the figures and lists that
   * describe them.
   */
  warnings: {
    /**
     * As in the header.
     */
    code: string;
  }[];
};

/**
 * A complete warp object, the size of the image, and the pixels of the map.
 */
export type Map = {
  p?: HandlesAtRest;
  q?: PosedHandles;
  align?: Align;
  strength?: Strength;
  weights?: Weights;
  depth?: Depth;
  method?: Method;
  alpha?: Alpha;
  point_mass?: PointMass;
  smoothing?: Smoothing;
  beier_neely?: BeierNeely;
  metric?: Metric;
  mask?: Mask;
  arap?: Arap;
  coincident?: Coincident;
  units?: Units;
  grid?: Grid;
  folds?: Folds;
  output?: Output;
  names?: HandleNames;
  format?: LandmarkFormat;
  unmatched?: Unmatched;
  /**
   * Width and height of the image, px.
   */
  extent: [number, number];
  direction?: Direction;
  canvas?: Canvas;
  /**
   * Pixels in a row of the map; default the width of the canvas. The height keeps the
   * proportions.
   */
  width?: number;
};

/**
 * A pose of a session and the pixels of the map.
 */
export type PosedMap = {
  q?: PosedHandles;
  strength?: Strength;
  direction?: Direction;
  canvas?: Canvas;
  /**
   * Pixels in a row of the map; default the width of the canvas. The height keeps the
   * proportions.
   */
  width?: number;
};

/**
 * `inverse`: for each pixel of the posed plane, the position in the source that is drawn
 * there; NaN where nothing is. `forward`: for each pixel of the plane at rest, the posed
 * position; NaN outside the source.
 */
export type Direction = "inverse" | "forward";

/**
 * The pose of a frame.
 */
export type BatchFrame = {
  q?: PosedHandles;
  strength?: Strength;
};

/**
 * The share t of the way from rest to the pose: in equal steps, or `3 s^2 - 2 s^3` of equal
 * steps s.
 */
export type Easing = "linear" | "ease-in-out";

/**
 * Random displacements that vary smoothly over the image: a sum of 64 plane waves of random
 * direction, wavelength, phase and polarisation, from ChaCha8 with this seed. The shortest
 * wavelength is the mean distance (root mean square) between the handles, the longest is
 * four times that, so that neighbouring handles move together. Each position moves by the
 * displacement at its position at rest. Frame k depends on the seed and on k alone, and is
 * the same on every machine.
 */
export type Jitter = {
  seed: number;
  /**
   * The number of frames.
   */
  count: number;
  /**
   * Standard deviation of the displacements along each axis, px; none is larger than 16 times
   * this.
   */
  sigma: number;
};

/**
 * The poses of a batch: `frames`, or `q` with `steps` or `jitter`; and what every frame has.
 * `jitter` needs no `q` (default: `p`), and in a session without handles it moves a grid of
 * 5 x 5 points, which lie from corner to corner, row by row. At most 10,000 frames. Without
 * its frames and annotations, the object has at most 4 MiB; each frame may be as large as a
 * drag. Annotations are in the pixels of the source; in the file they are in those of the
 * picture of the frame.
 */
export type Batch = {
  /**
   * A pose for each frame.
   */
  frames?: BatchFrame[];
  q?: PosedHandles;
  strength?: Strength;
  /**
   * The number of frames from rest (t = 0) to `q` (t = 1), both included.
   */
  steps?: number;
  easing?: Easing;
  jitter?: Jitter;
  /**
   * Layers that are drawn with every frame, each once.
   */
  layers?: LayerRef[];
  /**
   * How long an animation shows each frame, ms.
   */
  delay?: number;
  /**
   * How often an animation is played; 0 is without end.
   */
  loop?: number;
  /**
   * With `steps` and `frames`: all frames follow once more in the reverse order, except the
   * first and the last, which are not shown twice in a row. An animation with an end (`loop`)
   * also returns to its first frame.
   */
  and_back?: boolean;
  output?: Output;
  points?: Places;
  polygons?: Polygons;
  boxes?: Boxes;
  geojson?: GeoJson;
  /**
   * Add vertices to polygons, lines and rings where the map bends their edges by more than 0.1
   * px of the image of the result.
   */
  refine?: boolean;
};

/**
 * A share: a number, or one for each frame. The shares of all images add up to 1; negative
 * ones exaggerate. Left out everywhere, all images have equal shares, or with `steps` those
 * of a morph.
 */
export type BlendWeight = number | number[];

/**
 * One image of a blend: `image` or `session`.
 */
export type BlendImage = {
  /**
   * The number of the part `image`, and of its part `landmarks`, from 0.
   */
  image?: number;
  /**
   * The session whose image and handles at rest are meant.
   */
  session?: string;
  shape?: BlendWeight;
  colour?: BlendWeight;
  /**
   * The mirror image is meant, mirrored about the middle of the first image's width. With
   * halves of an image and its mirror image the result is symmetric.
   */
  mirror?: boolean;
  /**
   * With `mirror`: for each handle its mirror image, and itself for one on the axis. Default:
   * by names with left and right, otherwise by position.
   */
  pairs?: number[];
  p?: HandlesAtRest;
  /**
   * One name for each handle of `p`, by which handles are matched and mirrored; a landmark
   * file has its own.
   */
  names?: string[];
  item?: LandmarkItem;
};

/**
 * Which images are added, and how. The method and its parameters are those of a warp object.
 */
export type Blend = {
  /**
   * The images, in the order in which they are added. The first one gives the canvas and the
   * metadata.
   */
  images: BlendImage[];
  /**
   * The class of maps that places each shape over the reference.
   */
  align?: "none" | "rigid" | "similarity" | "affine";
  /**
   * The frame of the result: the shape of an entry of `images`, by its index; `mean`, the
   * Procrustes mean of all shapes, placed over the first; or handles in pixels.
   */
  reference?: number | "mean" | Handle[];
  /**
   * What is added: samples as files have them, or intensities of light by the curve of sRGB.
   */
  space?: "srgb" | "linear";
  match?: LandmarkMatch;
  /**
   * The number of frames of a morph from the first of two images to the second, both included.
   */
  steps?: number;
  method?: EffectiveMethod;
  alpha?: Alpha;
  point_mass?: PointMass;
  smoothing?: Smoothing;
  coincident?: Coincident;
  grid?: Grid;
  output?: Output;
};

/**
 * A method with its parameters. Defaults: `alpha` 1, `smoothing` 0. Methods are compared on
 * points, without an image: `beier_neely` and `arap` are refused.
 */
export type Candidate = {
  method: EffectiveMethod;
  /**
   * With `rigid`, `similarity` and `affine` only.
   */
  alpha?: number;
  smoothing?: Smoothing;
};

/**
 * The methods to be compared. Default: `affine`, `similarity` and `rigid`, each with alpha
 * 0.75, 1, 1.5 and 2; `tps` with smoothing 0, 0.001, 0.01 and 0.1; `global_affine`.
 */
export type Candidates = Candidate[];

/**
 * Points at rest and posed, and the size of the image.
 */
export type Fit = {
  p?: HandlesAtRest;
  q?: PosedHandles;
  align?: Align;
  weights?: Weights;
  coincident?: Coincident;
  units?: Units;
  /**
   * Width and height of the image, px.
   */
  extent: [number, number];
  candidates?: Candidates;
  names?: HandleNames;
  format?: LandmarkFormat;
  unmatched?: Unmatched;
};

export type PosedFit = {
  q?: PosedHandles;
  candidates?: Candidates;
};

/**
 * A method with its effective parameters; null where the method has no such parameter.
 */
export type Chosen = {
  method: EffectiveMethod;
  alpha: number | null;
  smoothing: number | null;
};

export type FitAnswer = {
  best: Chosen;
  candidates: ({
    method: EffectiveMethod;
    alpha: number | null;
    smoothing: number | null;
    /**
     * Root mean square length of the residuals, px; coincident handles count once.
     */
    rms: number;
    /**
     * Largest length, px.
     */
    max: number;
    /**
     * For each handle its posed position less the predicted one, px; null if it is missing.
     */
    residuals: ([number, number] | null)[];
    /**
     * Indices of handles whose residual exceeds the median length by 3.5 times 1.4826 times the
     * median absolute deviation, and by 0.001 px.
     */
    outliers: number[];
  })[];
};

/**
 * A landmark file, recognised by content; see `POST /landmarks`.
 */
export type LandmarkFile = Blob;

/**
 * Width and height of the image on which the landmarks were placed, such as a thumbnail or
 * another level of a pyramid. Positions in px are multiplied by the size of the uploaded
 * image over this one, width and height separately; without an image they become shares of
 * this one. Normalised positions are multiplied by it, and by default by the size of the
 * uploaded image. The extent of `q` is by default that of `p`. At most 250,000 px each.
 */
export type LandmarkExtent = string;

/**
 * Handles that were read from landmark files. It is a valid warp object.
 */
export type Landmarks = {
  p: HandlesAtRest;
  q?: PosedHandles;
  names?: HandleNames;
  units: Units;
  format: LandmarkFormat;
  unmatched?: Unmatched;
};

/**
 * The names of the handles, in their order, from landmark files. They have no effect in a
 * warp object.
 */
export type HandleNames = string[];

/**
 * The format of the landmark file that the handles were read from, of two files with
 * different formats both (`pts+csv`), and in parentheses how pixels were scaled. It has no
 * effect in a warp object, which refuses a format of another kind (that of the result is
 * `output.format`).
 */
export type LandmarkFormat = string;

/**
 * Names of landmarks that only one side has. They are left out of `p` and `q`. In a warp
 * object they cause the warning `landmarks_unmatched`.
 */
export type Unmatched = {
  p?: string[];
  q?: string[];
};

/**
 * How the landmarks of `landmarks_p` and `landmarks_q` are matched: those of one `name`, and
 * those that only one file has are left out; or in their `order`. By default by name if the
 * names explain both files: unless both have the same names in the same order, the names are
 * positions as ImageJ writes them (`0045-0030`), or they are repeated and have nothing in
 * common. Names that differ in case only are one name if that is unambiguous. If fewer than
 * half of the names match, the files are refused.
 */
export type LandmarkMatch = "name" | "order";

/**
 * As `item` of `warp`; a number is an index, unless an item has that name.
 */
export type LandmarkItemText = string;

/**
 * Which specimen, image, person or row of a landmark file is read, if it has several: an
 * index from 0, or a name. Of two files the same one.
 */
export type LandmarkItem = number | string;

/**
 * The annotations of the request, mapped. `null`: nothing maps there.
 */
export type PointsAnswer = {
  points?: (Place | null)[];
  polygons?: (Place[] | null)[];
  boxes?: (Box | null)[];
  geojson?: GeoJson;
};

/**
 * Distance between neighbouring grid lines along x and y, px. Lines are at 0, c, 2c, ...;
 * the last one is at the edge of the image.
 */
export type Cell = [number, number];

/**
 * The posed grid. Each cell is rendered as a bilinear patch. Where cells overlap, the one of
 * more `depth` wins, and among cells of one depth the later one in row order. Depths are not
 * in the mesh: a client that draws it orders its cells itself.
 */
export type Mesh = {
  /**
   * Vertices per row.
   */
  columns: number;
  /**
   * Vertices per column.
   */
  rows: number;
  /**
   * Width of the image, px.
   */
  width: number;
  /**
   * Height of the image, px.
   */
  height: number;
  cell: Cell;
  /**
   * Row by row, in the session's units of the source: the output of the session, its canvas
   * and width, does not change them.
   */
  vertices: Place[];
};

/**
 * A pose of a session.
 */
export type PosedHandlesOnly = {
  q?: PosedHandles;
  strength?: Strength;
  seq?: Seq;
};

/**
 * A mask of the size of the image: only the content inside moves, and everything else stays
 * the same. White moves, or opaque if the mask has transparent pixels; a feathered mask
 * gives a feathered transition. A session keeps it as its layer `region`.
 */
export type RegionFile = Blob;

export type LayerName = string;

/**
 * How the pixels of a layer are read.
 */
export type LayerKind = "image" | "labels";

/**
 * The state of a session. Values are the effective ones, not the requested ones.
 */
export type Session = {
  id: string;
  image: {
    width: number;
    height: number;
    /**
     * Digest of the bytes of the file.
     */
    digest: string;
  };
  p: HandlesAtRest;
  /**
   * The pose of the session, as it was sent: requests without `q` mean it. Absent if the
   * session has none.
   */
  q?: Handle[];
  /**
   * That of `q`; absent if it is 1.
   */
  strength?: number;
  weights?: Weights;
  depth?: Depth;
  method: EffectiveMethod;
  alpha?: Alpha;
  point_mass?: PointMass;
  smoothing?: Smoothing;
  beier_neely?: BeierNeely;
  /**
   * Absent if it is `euclidean`.
   */
  metric?: "geodesic";
  mask?: Mask;
  arap?: Arap;
  /**
   * The groups of coincident points, each of which is one handle; absent if no points
   * coincide.
   */
  coincident?: {
    /**
     * Indices into `p`, ascending.
     */
    handles: number[];
  }[];
  coincident_policy?: Coincident;
  units: Units;
  /**
   * How each `q` is aligned; absent if it is not.
   */
  align?: "rigid" | "similarity" | "affine";
  /**
   * Vertices per row and per column, and the grid as requested.
   */
  grid: {
    columns: number;
    rows: number;
    cell: Cell;
    requested?: Grid;
  };
  /**
   * Identifies the image size, the rest handles, the method and its parameters: it changes
   * when the coefficients change. Other `depth` alone leaves it as it is. The file of `GET
   * /sessions/{id}/plan` contains it.
   */
  rest_revision?: string;
  folds: Folds;
  output: Output;
  /**
   * The stored layers by name; absent if there are none.
   */
  layers?: Record<string, {
    kind: LayerKind;
  }>;
  created: string;
  /**
   * The time at which the session expires if it is not used.
   */
  expires: string;
  /**
   * The highest `seq` seen; null before the first.
   */
  seq: number | null;
};

export type ProblemSection = {
  type: string;
  title: string;
  status: number;
  code: string;
  /**
   * When the problem occurs.
   */
  detail: string;
  /**
   * What to do about it.
   */
  advice: string;
  example: Problem;
};

/**
 * A problem document (RFC 9457). Programs use `code`; `title` and `detail` are for people
 * and may change.
 */
export type Problem = {
  /**
   * The path of a page about the code: `/problems/<code>`, after the public path of the server
   * if it has one.
   */
  type: string;
  title: string;
  status: number;
  detail: string;
  code: "malformed_request" | "unauthorized" | "token_expired" | "forbidden" | "not_found" | "no_such_session" | "no_such_layer" | "method_not_allowed" | "not_acceptable" | "timeout" | "superseded" | "session_expired" | "too_large" | "unsupported_media_type" | "unsupported_format" | "misdirected" | "bad_image" | "bad_landmarks" | "nothing_visible" | "not_supported" | "unknown_field" | "bad_value" | "not_finite" | "shape_mismatch" | "contradictory_handles" | "degenerate_line" | "alpha_out_of_range" | "outside_mask" | "empty_mask" | "too_many_vertices" | "no_table" | "folded" | "unreachable" | "upgrade_required" | "rate_limited" | "internal" | "overloaded" | "unavailable" | "stored_by_another_version";
  /**
   * JSON pointer (RFC 6901) into the JSON of the request: the body, or the part `warp`.
   */
  pointer?: string;
  /**
   * Index into `p` and `q`.
   */
  handle?: number;
  /**
   * The name of the limit.
   */
  limit_name?: string;
  limit?: number | string;
  /**
   * The value requested or found.
   */
  actual?: number | string;
  /**
   * Seconds.
   */
  retry_after?: number;
  /**
   * With `bad_landmarks`: the line of the file, from 1.
   */
  line?: number;
  /**
   * With `bad_landmarks`: the character of the line, from 1.
   */
  column?: number;
  /**
   * With `bad_landmarks`, if the file has several specimens, images, persons or rows and
   * `item` chooses none of them: the names of each, in their order, as far as they fit.
   */
  items?: string[][];
  /**
   * With `items`: how many the file has. Beyond those in `items`, one is chosen by its index
   * or name all the same.
   */
  item_count?: number;
  /**
   * With `superseded`: the highest `seq` that the session has seen.
   */
  newest?: number;
  /**
   * With `unreachable`: indices of handles that no map without folds takes to their targets,
   * the first 100.
   */
  handles?: number[];
  /**
   * With `contradictory_handles`: the groups of handles that contradict each other.
   */
  coincident?: {
    /**
     * Indices, the first 100; one if a line visits the position more than once.
     */
    handles: number[];
    /**
     * At rest, px.
     */
    position: Place;
    /**
     * The largest difference of a displacement from the weighted mean displacement of the group,
     * px.
     */
    spread: number;
  }[];
  instance?: string;
  request_id?: string;
};
