// Animated GIF (89a): files of the engine, each a GIF of one frame, become the frames of one file; as
// `GifAnimation` in src/engine/codec/gif/write.rs.

/** Bytes of the signature and the size. */
const HEADER = 13;
/** Where, after them, the delay of the frame is. */
const DELAY = 4;
/** Without end. */
const REPEAT = Uint8Array.from("!\xff\vNETSCAPE2.0\x03\x01\0\0\0", (letter) =>
  letter.charCodeAt(0),
);
const TRAILER = 0x3b;

export class AnimatedGif {
  #count = 0;

  /** @param {number} delay how long each frame is shown, ms */
  constructor(delay) {
    this.delay = delay;
  }

  /**
   * What the next frame, a GIF file, adds to the file.
   *
   * @param {Uint8Array<ArrayBuffer>} file
   * @returns {Promise<Uint8Array<ArrayBuffer>[]>}
   */
  async frame(file) {
    const frame = file.slice(HEADER, -1);
    /** @type {(frame: number) => number} */
    const end = (frame) => Math.floor((frame * this.delay + 5) / 10);
    // Hundredths of a second. Viewers show frames of less than two of them much longer.
    const shown = Math.max(2, end(this.#count + 1) - end(this.#count));
    new DataView(frame.buffer).setUint16(DELAY, shown, true);
    return this.#count++ ? [frame] : [file.slice(0, HEADER), REPEAT, frame];
  }

  /** What follows the last frame. */
  end = async () => Uint8Array.of(TRAILER);
}
