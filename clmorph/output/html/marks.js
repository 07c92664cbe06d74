// Landmarks: pairs of points of both pictures, set by clicks, and copied as options.

/** Screen pixels within which a press takes a point that is there, and its radius as drawn. */
const GRASP = 12;
const RADIUS = 6;
/** Longest side of a picture in the panel, in pixels of its canvas. */
const SHARPEST = 1600;

/** A coordinate with a tenth of a pixel, and without a zero that says nothing. */
const coordinate = (value) => String(Math.round(value * 10) / 10 + 0);

/**
 * @param {object} marks pairs, sizes of both pictures as they were given, backwards, most
 * @param {object} nodes canvases (two), list, line, python, status: the elements of the panel
 * @param {(side: number) => Promise<ImageBitmap>} load the picture of a side, 0 or 1
 */
function makeMarks(marks, nodes, load) {
  // Each pair has a point for each side; the last one may still lack one (null).
  const pairs = marks.pairs.map((pair) => pair.map((point) => [...point]));
  const pictures = [null, null];
  let chosen = -1; // the pair that Delete removes
  let dragged = null; // { side, pair } while a point is moved

  const isWhole = (pair) => pair[0] !== null && pair[1] !== null;
  const whole = () => pairs.filter(isWhole);
  const hueOf = (pair) => (pair * 137.508 + 200) % 360;

  /** Where a point of a picture is on its canvas, in CSS pixels, and the reverse. */
  function toCanvas(side, [x, y]) {
    const { clientWidth, clientHeight } = nodes.canvases[side];
    const [width, height] = marks.sizes[side];
    return [((x + 0.5) / width) * clientWidth, ((y + 0.5) / height) * clientHeight];
  }

  function toPicture(side, event) {
    const frame = nodes.canvases[side].getBoundingClientRect();
    return marks.sizes[side].map((length, axis) => {
      const [at, low, room] = axis ? [event.clientY, frame.top, frame.height] : [event.clientX, frame.left, frame.width];
      const place = ((at - low) / room) * length - 0.5;
      return Math.max(0, Math.min(length - 1, Math.round(place * 10) / 10));
    });
  }

  /** The pair whose point on a side is under the pointer; -1 if there is none. */
  function under(side, event) {
    const frame = nodes.canvases[side].getBoundingClientRect();
    let [found, least] = [-1, GRASP];
    pairs.forEach((pair, k) => {
      if (pair[side] === null) return;
      const [x, y] = toCanvas(side, pair[side]);
      const distance = Math.hypot(x - (event.clientX - frame.left), y - (event.clientY - frame.top));
      if (distance < least) [found, least] = [k, distance];
    });
    return found;
  }

  function press(side, event) {
    if (event.button !== 0) return;
    event.preventDefault();
    const there = under(side, event);
    if (there >= 0) {
      dragged = { side, pair: there };
      nodes.canvases[side].setPointerCapture(event.pointerId);
      choose(there);
      return;
    }
    const last = pairs.length - 1;
    const point = toPicture(side, event);
    if (last >= 0 && !isWhole(pairs[last])) {
      pairs[last][side] = point; // its partner, or a better place for the point that waits for one
      chosen = last;
    } else if (pairs.length < marks.most) {
      pairs.push(side === 0 ? [point, null] : [null, point]);
      chosen = pairs.length - 1;
    }
    update();
  }

  function drag(event) {
    if (dragged === null) return;
    pairs[dragged.pair][dragged.side] = toPicture(dragged.side, event);
    update();
  }

  function choose(pair) {
    chosen = pair;
    update();
  }

  function remove(pair) {
    if (pair < 0 || pair >= pairs.length) return;
    pairs.splice(pair, 1);
    chosen = Math.min(chosen, pairs.length - 1);
    dragged = null;
    update();
  }

  function clear() {
    pairs.length = 0;
    chosen = -1;
    update();
  }

  const line = () => whole().map((pair) => `--landmark ${pair.map((point) => point.map(coordinate).join(",")).join(":")}`).join(" ");
  const python = () => `landmarks=[${whole().map((pair) => `(${pair.map((point) => `(${point.map(coordinate).join(", ")})`).join(", ")})`).join(", ")}]`;

  function drawSide(side) {
    const canvas = nodes.canvases[side];
    const picture = pictures[side];
    if (picture === null || !canvas.clientWidth) return;
    const ratio = devicePixelRatio;
    canvas.width = Math.min(SHARPEST, Math.round(canvas.clientWidth * ratio));
    canvas.height = Math.max(1, Math.round((canvas.width * canvas.clientHeight) / canvas.clientWidth));
    const context = canvas.getContext("2d");
    context.imageSmoothingEnabled = canvas.width < 4 * picture.width;
    context.imageSmoothingQuality = "high";
    context.drawImage(picture, 0, 0, canvas.width, canvas.height);
    const factor = canvas.width / canvas.clientWidth;
    context.setTransform(factor, 0, 0, factor, 0, 0);
    pairs.forEach((pair, k) => {
      if (pair[side] === null) return;
      const [x, y] = toCanvas(side, pair[side]);
      context.beginPath();
      context.arc(x, y, RADIUS, 0, 2 * Math.PI);
      context.lineWidth = k === chosen ? 5 : 3.5;
      context.strokeStyle = k === chosen ? "#fff" : "rgb(0 0 0 / .75)";
      context.stroke();
      context.lineWidth = 2;
      context.strokeStyle = `hsl(${hueOf(k)} 95% 62%)`;
      context.stroke();
      context.fillStyle = context.strokeStyle;
      context.fillRect(x - 1, y - 1, 2, 2);
      context.font = "600 12px system-ui, sans-serif";
      context.lineWidth = 3;
      context.strokeStyle = "rgb(0 0 0 / .8)";
      context.strokeText(String(k + 1), x + RADIUS + 3, y - RADIUS + 2);
      context.fillStyle = "#fff";
      context.fillText(String(k + 1), x + RADIUS + 3, y - RADIUS + 2);
    });
  }

  function item(pair, k) {
    const text = pair.map((point) => (point === null ? "\u2026" : point.map(coordinate).join(", "))).join(" \u2192 ");
    const remover = element("button", { type: "button", "aria-label": `Delete landmark ${k + 1}` }, "\u00d7");
    remover.addEventListener("click", (event) => {
      event.stopPropagation();
      remove(k);
    });
    const row = element("li", k === chosen ? { class: "chosen" } : {}, element("span", {}, text), remover);
    row.addEventListener("click", () => choose(k));
    return row;
  }

  function update() {
    drawSide(0);
    drawSide(1);
    nodes.list.replaceChildren(...pairs.map(item));
    nodes.line.value = line();
    nodes.python.value = python();
    const last = pairs[pairs.length - 1];
    if (last && !isWhole(last)) nodes.status.textContent = `Click the partner of landmark ${pairs.length} in picture ${last[0] === null ? "A" : "B"}.`;
    else if (pairs.length >= marks.most) nodes.status.textContent = `${marks.most} landmarks: there cannot be more.`;
    else nodes.status.textContent = "Click a point in one picture and its partner in the other; drag a point to move it.";
  }

  /** Load both pictures and draw; the panel must be visible, so that it has a size. */
  async function open() {
    for (const side of [0, 1]) {
      const canvas = nodes.canvases[side];
      const [width, height] = marks.sizes[side];
      canvas.style.aspectRatio = `${width} / ${height}`;
      canvas.style.setProperty("--aspect", width / height);
    }
    const loaded = await Promise.all([load(0), load(1)]);
    // Frames may be forgotten and closed later, so the panel has copies of its own.
    loaded.forEach((bitmap, side) => {
      const copy = document.createElement("canvas");
      [copy.width, copy.height] = [bitmap.width, bitmap.height];
      copy.getContext("2d").drawImage(bitmap, 0, 0);
      pictures[side] = copy;
    });
    update();
  }

  nodes.canvases.forEach((canvas, side) => {
    canvas.addEventListener("pointerdown", (event) => press(side, event));
    canvas.addEventListener("pointermove", drag);
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { dragged = null; });
    new ResizeObserver(() => drawSide(side)).observe(canvas);
  });

  return { open, clear, remove: () => remove(chosen), pairs: () => whole().map((pair) => pair.map((point) => [...point])) };
}

/** Copy the text of a field; where the clipboard is closed to the page, select it. */
async function copyText(field) {
  field.select();
  try {
    await navigator.clipboard.writeText(field.value);
    return true;
  } catch {
    try {
      return document.execCommand("copy");
    } catch {
      return false;
    }
  }
}
