// A brush that paints regions on both pictures: numbered colors, an eraser, a width, undo.

/** Colors of the labels on the page, and what the server reads: the red level of label k is 60 k. */
const LABELS = [["#3c00ff", "blue"], ["#78c800", "green"], ["#b400c8", "purple"]];
/** Longest side of a canvas; the server enlarges it to the picture's own size. */
const LONGEST = 1024;
const READ = { willReadFrequently: true };
/** Strokes that can be undone. */
const REMEMBERED = 20;

/**
 * Regions on two pictures.
 *
 * changed(side) is called after each stroke.
 * attach(side, frame, picture): paint on a picture; side 0 is A, 1 is B.
 * use(kind, now): paint "labels" of both pictures or the "mask" of the first; now is whether the
 * pointer paints at all.
 */
function makeBrush(changed) {
  const sides = [];
  const kinds = { labels: new Map(), mask: new Map() }; // canvases by the keys of pictures
  let kind = "";
  let painting = false;
  let strokes = 0;
  const filled = new WeakMap();
  const before = [];

  LABELS.forEach(([color, name], index) => {
    const input = Object.assign(document.createElement("input"), { type: "radio", name: "brush-color", value: String(index + 1), checked: index === 0 });
    const swatch = Object.assign(document.createElement("span"), { className: "swatch" });
    swatch.style.background = color;
    const label = Object.assign(document.createElement("label"), { className: "tick" });
    label.append(input, swatch, name);
    document.getElementById("colors").append(label);
  });
  const chosen = () => Number(document.querySelector("input[name=brush-color]:checked").value);
  const share = () => Number(document.getElementById("brush-width").value) / 100;

  function blank(picture) {
    const scale = Math.min(1, LONGEST / Math.max(picture.width, picture.height));
    const canvas = document.createElement("canvas");
    canvas.width = Math.max(1, Math.round(picture.width * scale));
    canvas.height = Math.max(1, Math.round(picture.height * scale));
    return canvas;
  }

  const copied = (canvas) => canvas.getContext("2d", READ).getImageData(0, 0, canvas.width, canvas.height);

  /** Squares of a grid of the canvas: no half-transparent edges, so that labels stay exact. */
  function dab(context, x, y, radius, label) {
    context.fillStyle = label ? LABELS[label - 1][0] : "#000";
    for (let row = Math.floor(y - radius); row <= y + radius; row += 1) {
      const half = Math.sqrt(Math.max(0, radius ** 2 - (row + 0.5 - y) ** 2));
      const [left, right] = [Math.round(x - half), Math.round(x + half)];
      if (right <= left) continue;
      if (label) context.fillRect(left, row, right - left, 1);
      else context.clearRect(left, row, right - left, 1);
    }
  }

  const sideOf = (key) => sides.findIndex(({ picture }) => picture.key === key);
  const canvasOf = (side) => kinds[kind].get(sides[side].picture.key);

  function listen(key, canvas) {
    let last = null;
    const at = (event) => {
      const box = canvas.getBoundingClientRect();
      return [((event.clientX - box.left) / box.width) * canvas.width, ((event.clientY - box.top) / box.height) * canvas.height];
    };
    const line = (from, to) => {
      const context = canvas.getContext("2d", READ);
      const radius = Math.max(0.6, (share() * Math.max(canvas.width, canvas.height)) / 2);
      const steps = Math.max(1, Math.ceil(Math.hypot(to[0] - from[0], to[1] - from[1]) / Math.max(1, radius / 3)));
      for (let k = 0; k <= steps; k += 1) {
        dab(context, from[0] + ((to[0] - from[0]) * k) / steps, from[1] + ((to[1] - from[1]) * k) / steps, radius, chosen());
      }
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      canvas.setPointerCapture(event.pointerId);
      before.push([key, canvas, copied(canvas)]);
      if (before.length > REMEMBERED) before.shift();
      last = at(event);
      line(last, last);
      event.preventDefault();
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!last) return;
      for (const each of event.getCoalescedEvents?.() ?? [event]) {
        const next = at(each);
        line(last, next);
        last = next;
      }
    });
    // By keyboard: arrow keys move a ring, Enter paints there.
    const ring = Object.assign(document.createElement("span"), { className: "ring", hidden: true });
    let cursor = [canvas.width / 2, canvas.height / 2];
    const show = () => {
      const long = Math.max(canvas.width, canvas.height);
      ring.style.left = `${(100 * cursor[0]) / canvas.width}%`;
      ring.style.top = `${(100 * cursor[1]) / canvas.height}%`;
      ring.style.width = `${(100 * share() * long) / canvas.width}%`;
      canvas.after(ring);
      ring.hidden = false;
    };
    canvas.addEventListener("focus", () => { if (canvas.matches(":focus-visible")) show(); });
    canvas.addEventListener("blur", () => { ring.hidden = true; });
    canvas.addEventListener("keydown", (event) => {
      const step = Math.max(1, (share() * Math.max(canvas.width, canvas.height)) / 4);
      const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
      if (way) {
        const sides = [canvas.width, canvas.height];
        cursor = cursor.map((each, axis) => Math.min(Math.max(each + step * way[axis], 0), sides[axis]));
      } else if (event.key === "Enter" || event.key === " ") {
        before.push([key, canvas, copied(canvas)]);
        if (before.length > REMEMBERED) before.shift();
        line(cursor, cursor);
        look(canvas);
        changed(sideOf(key));
      } else return;
      show();
      event.preventDefault();
    });
    const end = () => {
      if (!last) return;
      last = null;
      look(canvas);
      changed(sideOf(key));
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("click", (event) => event.stopPropagation());
  }

  /** Look whether a canvas has paint; remembered, because previews ask for it often. */
  function look(canvas) {
    filled.set(canvas, new Uint32Array(copied(canvas).data.buffer).some((value) => value !== 0));
    strokes += 1;
  }

  function arrange() {
    sides.forEach(({ frame, picture }, side) => {
      for (const old of frame.querySelectorAll("canvas, .ring")) old.remove();
      frame.classList.remove("painting");
      if (!kind || (kind === "mask" && side === 1)) return;
      if (!kinds[kind].has(picture.key)) {
        const made = blank(picture);
        kinds[kind].set(picture.key, made);
        listen(picture.key, made);
      }
      const canvas = canvasOf(side);
      canvas.setAttribute("aria-label", `Painted regions of picture ${"AB"[side]}: arrow keys move the brush, Enter paints`);
      canvas.setAttribute("role", "application");
      canvas.tabIndex = painting ? 0 : -1;
      frame.append(canvas);
      frame.classList.toggle("painting", painting);
    });
  }

  return {
    attach(side, frame, picture) {
      sides[side] = { frame, picture };
      arrange();
    },
    detach() {
      sides.length = 0;
      before.length = 0;
    },
    use(now, active) {
      kind = now;
      painting = active;
      arrange();
    },
    get any() {
      return sides.length === 2 && Boolean(kind) && sides.some((_, side) => filled.get(canvasOf(side)));
    },
    /** The number of changes so far, which tells one state from another. */
    get strokes() { return strokes; },
    png(side) {
      return new Promise((resolve) => { canvasOf(side).toBlob(resolve, "image/png"); });
    },
    clear() {
      sides.forEach((_, side) => {
        const canvas = canvasOf(side);
        if (!canvas) return;
        canvas.getContext("2d", READ).clearRect(0, 0, canvas.width, canvas.height);
        look(canvas);
      });
      before.length = 0;
      changed(0);
    },
    undo() {
      const [key, canvas, data] = before.pop() ?? [];
      if (!key) return;
      canvas.getContext("2d", READ).putImageData(data, 0, 0);
      look(canvas);
      changed(Math.max(0, sideOf(key)));
    },
  };
}
