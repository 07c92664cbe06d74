// The stage: frames in the common frame, at their true scale, zoomed and moved.

/** Zoom steps of the buttons, in screen pixels for each pixel of the finest frame. */
const ZOOMS = [1, 1.5, 2, 3, 4, 6, 8, 12, 16];
/** Space between the picture and the stage's border. */
const MARGIN = 12;
/** Pixels that a finger may move in a tap. */
const STILL = 8;

/**
 * @param {object} scene what the page knows of its frames
 * @param {HTMLElement} stage holds everything
 * @param {HTMLElement} box is as large as the frame
 * @param {HTMLCanvasElement} canvas has the frame's pixels, one to one
 * @param {() => void} changed called when scale, place or smoothing have changed
 * @param {() => void} tapped called when the stage is pressed, and not dragged
 */
function makeStage(scene, stage, box, canvas, changed, tapped) {
  const options = { colorSpace: "srgb" };
  // Canvases multiply colors by opacity; in 16 bits nothing is lost by that. Browsers without
  // such canvases round the colors of half-transparent pixels, and of no others.
  if (scene.alpha) options.colorType = "float16";
  const context = canvas.getContext("2d", options);
  const widest = largest(scene.boxes.map((b) => b[0]));
  const tallest = largest(scene.boxes.map((b) => b[1]));
  const finest = largest(scene.boxes.map((b, i) => scene.sizes[i][0] / b[0]));
  const steady = scene.boxes.every((b) => b.every((side, i) => Math.abs(side - scene.boxes[0][i]) < 1e-6));
  // Screen pixels for each unit; null fits. The picture's center, from the stage's, in pixels.
  const view = { scale: null, x: 0, y: 0, pixelated: scene.pixelated };
  let index = 0;

  function fitting() {
    const width = Math.max(16, stage.clientWidth - 2 * MARGIN);
    const height = Math.max(16, stage.clientHeight - 2 * MARGIN);
    const scale = Math.min(width / widest, height / tallest);
    if (!view.pixelated || !steady) return scale;
    // Squares of whole pixels of the screen, all of one size.
    const side = (scale / finest) * devicePixelRatio;
    return side < 1 ? scale : (scale * Math.floor(side)) / side;
  }

  const scale = () => (view.scale === null ? fitting() : view.scale);
  const zoom = () => scale() / finest;
  const lowest = () => Math.min(1, fitting() / finest);
  const highest = () => Math.max(16, fitting() / finest);

  function arrange() {
    const s = scale();
    const [width, height] = scene.boxes[index];
    const limit = (side, room) => Math.max(0, (side * s + 2 * MARGIN - room) / 2);
    const [across, down] = [limit(widest, stage.clientWidth), limit(tallest, stage.clientHeight)];
    view.x = Math.max(-across, Math.min(across, view.x));
    view.y = Math.max(-down, Math.min(down, view.y));
    const left = stage.clientWidth / 2 + view.x - (width * s) / 2;
    const top = stage.clientHeight / 2 + view.y - (height * s) / 2;
    // Onto pixels of the screen, wherever the stage itself stands.
    const page = stage.getBoundingClientRect();
    const snap = (value, from) => Math.round((from + value) * devicePixelRatio) / devicePixelRatio - from;
    box.style.width = `${width * s}px`;
    box.style.height = `${height * s}px`;
    box.style.left = `${snap(left, page.left)}px`;
    box.style.top = `${snap(top, page.top)}px`;
    canvas.classList.toggle("pixelated", view.pixelated);
    stage.classList.toggle("movable", across > 0 || down > 0);
    changed();
  }

  /** Draw a decoded frame, pixel by pixel. */
  function draw(next, bitmap) {
    index = next;
    if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) {
      canvas.width = bitmap.width;
      canvas.height = bitmap.height;
    }
    context.imageSmoothingEnabled = false;
    context.globalCompositeOperation = "copy";
    context.drawImage(bitmap, 0, 0);
    arrange();
  }

  /** Zoom to so many pixels, or fit (null); what is at (x, y) of the stage stays there. */
  function zoomTo(value, x = stage.clientWidth / 2, y = stage.clientHeight / 2) {
    const before = scale();
    if (value === null) {
      Object.assign(view, { scale: null, x: 0, y: 0 });
    } else {
      view.scale = Math.max(lowest(), Math.min(highest(), value)) * finest;
      const grown = view.scale / before;
      const [dx, dy] = [x - stage.clientWidth / 2, y - stage.clientHeight / 2];
      view.x = dx + (view.x - dx) * grown;
      view.y = dy + (view.y - dy) * grown;
    }
    arrange();
  }

  /** One step of the buttons, up (1) or down (-1). */
  function step(sign) {
    const steps = ZOOMS.filter((value) => (sign > 0 ? value > zoom() * 1.001 : value < zoom() * 0.999));
    if (steps.length) zoomTo(sign > 0 ? steps[0] : steps[steps.length - 1]);
    else if (sign < 0) zoomTo(lowest());
  }

  function move(dx, dy) {
    view.x += dx;
    view.y += dy;
    arrange();
  }

  function setPixelated(value) {
    view.pixelated = value;
    arrange();
  }

  /** Where a point of the common frame is on the stage, in pixels, at the frame shown. */
  function place(x, y) {
    const [, , width, height] = scene.boxes[index];
    const s = scale();
    return [
      stage.clientWidth / 2 + view.x + (x - 0.5) * width * s,
      stage.clientHeight / 2 + view.y + (y - 0.5) * height * s,
    ];
  }

  /** Pixels of the stage for the unit of the common frame, at the frame shown. */
  const unit = () => Math.max(scene.boxes[index][2], scene.boxes[index][3]) * scale();

  listen();
  return { view, zoom, zoomTo, step, move, draw, arrange, setPixelated, place, unit };

  /** Wheel, drag and pinch. */
  function listen() {
    const at = (event) => {
      const frame = stage.getBoundingClientRect();
      return [event.clientX - frame.left, event.clientY - frame.top];
    };
    // In a notebook, or where the page scrolls, the wheel scrolls on unless Ctrl is held.
    const scrolls = () => window.parent !== window
      || document.documentElement.scrollHeight > document.documentElement.clientHeight + 1;
    stage.addEventListener("wheel", (event) => {
      if (scrolls() && !event.ctrlKey && !event.metaKey) return;
      event.preventDefault();
      const pixels = event.deltaY * (event.deltaMode === 1 ? 16 : 1);
      zoomTo(zoom() * Math.exp(-Math.max(-100, Math.min(100, pixels)) / 250), ...at(event));
    }, { passive: false });

    const fingers = new Map();
    let traveled = 0; // pixels, since the first finger came down
    const spread = () => {
      const [a, b] = [...fingers.values()];
      return { distance: Math.hypot(a[0] - b[0], a[1] - b[1]), middle: [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2] };
    };
    stage.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      if (!fingers.size) traveled = 0;
      fingers.set(event.pointerId, at(event));
      stage.setPointerCapture(event.pointerId);
    });
    stage.addEventListener("pointermove", (event) => {
      const from = fingers.get(event.pointerId);
      if (!from) return;
      const to = at(event);
      traveled += Math.hypot(to[0] - from[0], to[1] - from[1]);
      if (fingers.size === 2) {
        traveled = Infinity;
        const old = spread();
        fingers.set(event.pointerId, to);
        const now = spread();
        move(now.middle[0] - old.middle[0], now.middle[1] - old.middle[1]);
        if (old.distance > 0) zoomTo(zoom() * (now.distance / old.distance), ...now.middle);
        return;
      }
      fingers.set(event.pointerId, to);
      if (fingers.size === 1) move(to[0] - from[0], to[1] - from[1]);
    });
    stage.addEventListener("pointerup", (event) => {
      if (fingers.delete(event.pointerId) && !fingers.size && traveled < STILL) tapped();
    });
    stage.addEventListener("pointercancel", (event) => fingers.delete(event.pointerId));
    new ResizeObserver(arrange).observe(stage);
  }
}
