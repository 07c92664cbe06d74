// Frames: decoded shortly before they are needed, forgotten when there are too many.

/** Bytes of decoded pixels that are kept. */
const KEPT_BYTES = 256e6;
/** Frames that are decoded ahead, and how many at a time. */
const AHEAD = 12;
const AT_ONCE = 4;

/** Without these, browsers change colors: by their profile, or by multiplying with opacity. */
const AS_STORED = { premultiplyAlpha: "none", colorSpaceConversion: "none" };

/**
 * @param {Element[]} nodes data blocks of the page: base64, with a media type
 * @param {number[][]} sizes width and height of each
 */
function makeFrames(nodes, sizes) {
  const decoded = new Map(); // index -> ImageBitmap, the least recently used first
  const pending = new Map(); // index -> Promise
  let bytes = 0;
  const cost = (index) => 4 * sizes[index][0] * sizes[index][1];

  function blob(index) {
    const text = atob(nodes[index].textContent);
    const data = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i += 1) data[i] = text.charCodeAt(i);
    return new Blob([data], { type: nodes[index].type });
  }

  function forget() {
    for (const [index, bitmap] of decoded) {
      // Enough stay to go on with, however large they are.
      if (bytes <= KEPT_BYTES || decoded.size <= AHEAD + 2) return;
      decoded.delete(index);
      bitmap.close();
      bytes -= cost(index);
    }
  }

  /** The decoded frame, or null if it is not yet. */
  function get(index) {
    const bitmap = decoded.get(index);
    if (!bitmap) return null;
    decoded.delete(index);
    decoded.set(index, bitmap);
    return bitmap;
  }

  /** Promise of the decoded frame. */
  function load(index) {
    const bitmap = get(index);
    if (bitmap) return Promise.resolve(bitmap);
    if (!pending.has(index)) {
      const made = createImageBitmap(blob(index), AS_STORED).then(
        (fresh) => {
          pending.delete(index);
          decoded.set(index, fresh);
          bytes += cost(index);
          forget();
          return fresh;
        },
        (error) => {
          pending.delete(index);
          throw new Error(`frame ${index + 1} cannot be decoded by this browser (${error.message})`);
        },
      );
      pending.set(index, made);
    }
    return pending.get(index);
  }

  /** Decode what comes next; errors show when a frame is needed. */
  function prefetch(indices) {
    for (const index of indices) {
      if (pending.size >= AT_ONCE) return;
      if (!decoded.has(index)) load(index).catch(() => {});
    }
  }

  return { count: nodes.length, get, load, prefetch, blob };
}
