// The shapes that the modules of the page share, for tsc (`tests/lint/run`) and editors. Not
// served:
// the page has no build step, and its types are JSDoc.

declare namespace Page {
  /**
   * A value of a file, a link, the storage of the browser or a message: anything may be in it. It
   * is
   * `any`, because the code that reads it checks each member where it takes it.
   */
  type Json = any;

  /** x, y: px of the picture or, in what is drawn, CSS px of the stage. */
  type Place = [number, number];
  /** Width, height. */
  type Size = [number, number];
  /** x, y, width, height: px of the picture. */
  type Box = [number, number, number, number];
  /** At rest or posed. */
  type Which = "p" | "q";
  /** Where a picture is on a canvas, px of the canvas, and how much it is magnified. */
  type Placed = { zoom: number; x: number; y: number };

  // The document

  /** The name of one of `METHODS`. */
  type Method = string;
  /** A row of the server's table of methods. */
  type MethodInfo = {
    name: Method;
    title: string;
    sentence: string;
    handles: "all" | "points" | "lines";
    /** Whether handles are met; or the parameter that must be 0 for it. */
    interpolates: boolean | string;
    /** Whether its parameters stand in an object of its name. */
    object: boolean;
    /** Whether it draws a mesh of its own, so that there is no grid to choose. */
    mesh: boolean;
    /** `default`: null if it depends on the image. */
    parameters: { name: string; default: number | null; sentence: string }[];
  };
  type Metric = "euclidean" | "geodesic";
  type Filter = "nearest" | "bilinear" | "bicubic";
  type Holes = "keep" | "transparent";
  type AlignClass = "none" | "rigid" | "similarity" | "affine";
  /** `transparent`, `edge`, `reflect`, `#rrggbbaa`, or a value of the picture's depth. */
  type Outside = string | OutsideValue;
  type OutsideValue = { value: number | number[] };
  type CanvasBox = { x: number; y: number; width: number; height: number };
  type Canvas = "same" | "fit" | CanvasBox;
  /** `auto`, a tolerance in px, or the side of a cell in px. */
  type Grid = "auto" | number | { tolerance: number };
  /** How a pin is turned (degrees) and scaled by the other handles alone. */
  type Turn = { angle: number; scale: number };
  /**
   * `length`: of the segment that the server gets; `free`: the angle without the twist, if known.
   */
  type Twist = { angle: number; scale: number; length: number; free?: number };
  /** One position is a point ("pin"), two are a line, more a path. */
  type Handle = {
    id: number;
    p: Place[];
    q: Place[];
    weight?: number;
    depth?: number;
    twist?: Twist;
  };
  type HandleKind = "point" | "line" | "path";

  type RegionPart =
    | { kind: "lasso"; removes: boolean; places: Place[] }
    | { kind: "brush"; removes: boolean; places: Place[]; size: number }
    | { kind: "invert"; removes?: undefined }
    | { kind: "mask"; removes?: undefined; png: string };
  /** The part of the picture that moves; without parts, all of it. */
  type Region = { parts: RegionPart[]; feather: number };

  /** What the user edits. Documents of older pages lack some members. */
  type Document = {
    handles: Handle[];
    method: Method;
    /** null: automatic. */
    alpha: number | null;
    grid: Grid;
    /** Absent: that of the plane, or what is usual for a new picture. */
    metric?: Metric;
    /** The share of full alpha above which a pixel belongs to the outline's inside. */
    threshold?: number;
    outside?: Outside;
    filter?: Filter;
    canvas?: Canvas;
    region?: RegionPart[];
    feather?: number;
    /** null: what is usual for the picture. */
    holes?: Holes | null;
    smoothing?: number;
    /** What becomes of folds, once that was chosen. */
    folds?: "report" | "remove";
    /** Parameters in the object of a method, by its name. */
    own?: Record<string, Record<string, number>>;
    /** Mass of a point, px, if it is not the server's default. */
    mass?: number;
    coincident?: { policy: "mean" | "reject"; within: number };
    /** The class of the alignment, and the handles before it. */
    align?: { by: AlignClass; handles: Handle[] };
    /** The strength that `handles` show, and the handles of the full pose. */
    strength?: number;
    full?: Handle[];
    /** The names of the two landmark files. */
    sides?: string[];
  };

  // The state

  type Tool = HandleKind | "lasso" | "brush";
  type Phase = "empty" | "uploading" | "open";
  type Picture = {
    name: string;
    width: number;
    height: number;
    /** Whether a part of it is transparent. */
    isCutout: boolean;
    /** Address of a sample. */
    sample?: string | null;
    /** Whether it came by a link to the session of another user. */
    linked?: boolean;
  };
  /** GeoJSON over the picture, and the name of its file. */
  /** GeoJSON; `key`: that of the stored file. */
  type Annotations = { name: string; geojson: Json; key?: IDBValidKey | null };
  /** Handles of a file: of a document or, in shares of the picture's size, of a warp object. */
  type HandlesFile = {
    name: string;
    document: Document;
    warp: Json;
    missing: number;
    /** Whether it has positions alone, and no settings. */
    isLandmarks?: boolean;
    /** The files, if only the picture tells how they are read; the others are empty then. */
    later?: File[];
  };
  type Waiting = { handles?: HandlesFile | null; annotations?: Annotations | null };
  type Animation = {
    easing: "linear" | "ease-in-out";
    back: boolean;
    frames: number;
    file: "apng" | "gif" | "zip";
  };
  /** Why a method was chosen: what the figures and arrows show. */
  type Fit = { residuals: Place[]; outliers: number[]; scale: number; words: string };
  /** A file of a picture. */
  type Source = { blob: Blob; name: string };
  /**
   * A picture of the history, with all that is needed to show it again; `picture` null: the start.
   */
  type KeptPicture = {
    picture: Picture;
    document: Document;
    past: Document[];
    future: Document[];
    annotations?: Annotations | null;
    session: string;
    borrowed: boolean;
    /** Key of the stored file. */
    file?: IDBValidKey | null;
    source?: Source | null;
    link?: string | null;
  };
  type Start = {
    picture: null;
    annotations?: undefined;
    document?: undefined;
    past?: undefined;
    future?: undefined;
    file?: undefined;
    link?: undefined;
  };
  type Kept = KeptPicture | Start;
  /** Pictures that undo and redo bring back. */
  type History = { earlier: Kept[]; later: Kept[] };

  type State = History & {
    phase: Phase;
    progress: number;
    uploadName?: string;
    picture: Picture | null;
    document: Document;
    /** Increases with every change of the document. */
    revision: number;
    /** "7" is a whole handle, "7.2" a vertex of it. */
    selection: string[];
    tool: Tool;
    draft: Place[];
    arm: "" | "move";
    more: boolean;
    /** Of the keyboard, px of the picture. */
    cross: Place | null;
    /** The document at the start of a drag. */
    before: Document | null;
    past: Document[];
    future: Document[];
    waiting: Waiting | null;
    annotations: Annotations | null;
    /** Names of files that were opened with others, and not used. */
    unused: string[];
    /** Whether the user has closed what is told about rest and pose, and about holes. */
    sidesClosed: boolean;
    holesClosed: boolean;
    tag: string;
    tagged: number;
    problem: Problem | null;
    fit: Fit | null;
    fitShown: boolean;
    /** Indices of handles that coincide at rest and are moved apart. */
    apart: number[];
    meshShown: boolean;
    compare: boolean;
    compareAt: number;
    peek: boolean;
    /** Whether lasso and brush take away from the region. */
    removes: boolean;
    /** Size of the brush, px; null: by the size of the picture. */
    brush: number | null;
    regionShown: boolean;
    /** While the animation plays, the strength that is shown. */
    playing: null | "preparing" | number;
    animation: Animation;
  };

  /** What an action carries, by its name: `store.do(name, content)`. */
  type Actions = {
    uploading: { name: string };
    progress: { percent: number };
    uploadEnded: {};
    opened: History & {
      picture: Picture | null;
      document?: Document;
      annotations?: Annotations | null;
      past?: Document[];
      future?: Document[];
    };
    history: History;
    waiting: Waiting;
    annotations: { annotations: Annotations | null };
    unused: { names: string[] };
    edit: { document: Document; select?: string[]; tag?: string; now?: number };
    fit: { fit: Fit };
    dragBegin: {};
    drag: { document: Document };
    dragEnd: {};
    dragCancel: {};
    undo: {};
    redo: {};
    select: { keys: string[] };
    toggle: { key: string };
    tool: { tool: Tool };
    draft: { places: Place[] };
    arm: { arm: "" | "move" };
    more: { more: boolean };
    cross: { place: Place | null };
    problem: { problem: Problem | null };
    apart: { handles: number[] };
    play: { playing: State["playing"] };
    animation: { change: Partial<Animation> };
    show: { what: Partial<State> };
  };

  // The server's form

  /** A point is a position, a line or path a list of positions. */
  type WireHandle = Place | Place[];
  /** A warp object, or the part of it that a session keeps: what is sent. */
  type Rest = {
    p: WireHandle[];
    weights?: number[];
    depth?: number[];
    method: Method;
    alpha?: number;
    point_mass?: number;
    smoothing?: number;
    metric?: Metric;
    mask?: { threshold: number };
    coincident: NonNullable<Document["coincident"]>;
    grid: "auto" | { tolerance: number } | { cell: number };
    folds?: "report" | "remove";
    output: { outside: Outside; filter: Filter; canvas: Canvas; holes?: Holes };
  };
  /** A complete warp object. */
  type Warp = Omit<Rest, "coincident" | "output"> & {
    q: WireHandle[];
    coincident?: Rest["coincident"];
    output?: Partial<Rest["output"]>;
    align?: AlignClass;
  };
  /** The handles of landmark files. */
  type Landmarks = { p: WireHandle[]; q?: WireHandle[]; names?: string[]; units: string };
  /** The fields of `output` that an export sets. */
  type Output = {
    format?: "jpeg" | "webp";
    quality?: number;
    compression?: string;
    width?: number;
    outside?: string;
  };
  type Pose = { q: WireHandle[]; seq?: number; output?: Output };
  /** The session object, as far as the page reads it. */
  type SessionObject = {
    id: string;
    image: { width: number; height: number };
    /** Names the coefficients of the rest handles. */
    rest_revision: string;
    seq: number | null;
    expires: string;
    p: WireHandle[];
    weights?: number[];
    depth?: number[];
    method: Method;
    alpha?: number;
    point_mass?: number | null;
    smoothing?: number;
    metric?: Metric;
    mask?: { threshold: number };
    coincident?: { handles: number[] }[];
    coincident_policy?: NonNullable<Document["coincident"]>;
    units: string;
    align?: AlignClass;
    grid: { columns: number; rows: number; cell: Size; requested: Rest["grid"] };
    folds?: Json;
    output: Rest["output"];
    layers?: { region?: Json };
  };
  type FitCandidate = {
    method: Method;
    alpha: number | null;
    smoothing: number | null;
    rms: number;
    residuals: Place[];
    outliers: number[];
  };
  type FitBest = Pick<FitCandidate, "method" | "alpha" | "smoothing">;
  /** The figures of a response. `error`: of a compact mesh; `trip`: ms until it was here. */
  type Report = {
    timing: Record<string, number>;
    size: number;
    folds: number;
    residual: number;
    warnings: string[];
    canvas: Box | null;
    trip?: number;
    error?: number;
  };
  /** The report of a frame of the drag socket. */
  type FrameReport = Partial<Report> & Pick<Report, "timing" | "size"> & { seq?: number };

  // The work with the server

  /** Vertices of a mesh, and the side of a cell in px of the picture. */
  type MeshGrid = { columns: number; rows: number; cell: Size; width: number; height: number };
  /** The session of the open picture. */
  type Session = {
    id: string;
    grid: MeshGrid;
    /** Of the rest handles. */
    revision: string;
    /** What it has been given, as JSON; null: unknown, a request is running. */
    rest: string | null;
    region: Region | null;
    /** What determines its pictures, except q, as JSON. */
    setup: string;
    /** Whether it belongs to another user. */
    borrowed: boolean;
  };
  /** What is shown, and the figures of it. */
  type Shown = {
    revision: number | null;
    source: "none" | "mesh" | "frame" | "png";
    folds: number;
    residual: number | null;
    report: FrameReport | null;
    /** Frames per second of a drag. */
    rate: number;
    warnings: string[];
    plan?: Plan | null;
  };
  /** Limits of the server: bytes of a request, pixels and side of a picture, seconds, 1 or 0. */
  type Limits = { body: number; pixels: number; side: number; idle: number; memory: number };
  /** What buttons and keys do (main.js). */
  type Does = {
    pick: () => void;
    pickHandles: () => void;
    close: () => void;
    export: () => void;
    help: () => void;
    key: () => void;
    tool: (tool: Tool) => void;
    mesh: () => void;
    removes: (removes: boolean) => void;
    compare: () => void;
    play: () => void;
    arm: () => void;
    fit: () => Promise<void>;
    full: () => void;
    mending: (problem: Problem) => string | null;
    alternative: (problem: Problem) => string | null;
    mend: (problem: Problem, action: string | null) => void;
  };

  // What is on the stage

  /** A handle, or one of its vertices (null: all of it). */
  type Named = { handle: Handle; index: number; vertex: number | null };
  type Circle = { centre: Place; radius: number };
  /** The ring around a selection, stage px; `pin`: the point that it turns. */
  type Ring = { pin: Handle | null; centre: Place; middle: Place; r: number; knob: Place };
  /** How a handle looks: `fault` null, "" (an error) or "warning". */
  type Mark = { pressed: boolean[]; fault: "" | "warning" | null; labels: string[] };
  type PointerKind = "mouse" | "pen" | "touch";

  // The classes and their instances

  type Problem = import("./api.js").Problem;
  type Store = import("./state.js").Store;
  type View = import("./view.js").View;
  type Sync = import("./sync.js").Sync;
  type Mesh = import("./mesh.js").Mesh;
  type Plan = import("./plan.js").Plan;
  type UserActions = import("./actions.js").Actions;
  type Handles = import("./handles.js").Handles;
}

interface Array<T> {
  /** A tuple stays one: the middle of two places is a place. */
  map<Tuple extends [T, ...T[]], U>(
    this: Tuple,
    act: (value: T, index: number) => U,
  ): { [At in keyof Tuple]: U };
}

// The examples of the guide import this module by its address on the server.
declare module "*/page/access.js" {
  export const keyHeaders: typeof import("./access.js").keyHeaders;
  export const keyProtocols: typeof import("./access.js").keyProtocols;
}

/** The script of the API reference (docs/reference.js). */
declare const Scalar: { createApiReference: (selector: string, wish: object) => void };
