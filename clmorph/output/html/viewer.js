// Everything together: controls, keys, and what scripts and tests may use.

/** Speeds, in multiples of the film's own. */
const SPEEDS = [0.25, 0.5, 1, 2, 4];
const LOOPS = ["ping-pong", "loop", "once"];

const $ = (id) => document.getElementById(id);
const scene = JSON.parse($("clmorph-scene").textContent);
const frames = makeFrames([...document.querySelectorAll("script.frame")], scene.sizes);
const { times } = scene;
const digits = Math.max(2, Math.ceil(Math.log10(times.length / (times[times.length - 1] - times[0] || 1))));

const arrows = makeArrows(scene.fields, $("arrows"), { place: (x, y) => stage.place(x, y), unit: () => stage.unit() });
const stage = makeStage(scene, $("stage"), $("box"), $("canvas"), () => {
  const fits = stage.view.scale === null;
  $("zoom").textContent = fits ? "Fit" : `${short(stage.zoom())}\u00d7`;
  $("zoom").setAttribute("aria-label", `Zoom: ${fits ? "fit" : $("zoom").textContent}`);
  $("zoom").setAttribute("aria-pressed", fits);
  press("pixels", stage.view.pixelated);
  arrows.draw(times[player.state.index]);
}, () => toggle());
const player = makePlayer(frames, scene, show, controls, fail);
const charts = makeCharts(scene.curves, times, $("charts"), (time) => {
  player.pause();
  seek(time);
});
const marks = scene.marks && makeMarks(scene.marks, {
  canvases: [$("marks-a"), $("marks-b")], list: $("marks-list"), line: $("marks-line"),
  python: $("marks-python"), status: $("marks-status"),
}, (side) => frames.load((side === 1) !== scene.marks.backwards ? player.last : 0));
let announced = 0;

function fail(error) {
  $("failure").textContent = error.message;
  $("failure").hidden = false;
}

function press(id, on) {
  $(id).setAttribute("aria-pressed", on);
}

/** Draw a decoded frame, and move everything that follows it. */
function show(index) {
  stage.draw(index, frames.get(index));
  const time = times[index].toFixed(digits);
  const [width, height] = scene.sizes[index];
  $("time").textContent = time;
  $("frame").textContent = `${index + 1} / ${times.length}`;
  $("size").textContent = `${width} \u00d7 ${height}`;
  $("scrub").value = index;
  $("scrub").style.setProperty("--done", player.last ? index / player.last : 0);
  charts.update(index);
  // Not at every frame: a reader that speaks them would never come to an end.
  if (!player.state.playing || performance.now() - announced > 1000) {
    announced = performance.now();
    $("scrub").setAttribute("aria-valuetext", `frame ${index + 1} of ${times.length}, t = ${time}`);
    $("canvas").setAttribute("aria-label", `The morph at t = ${time}`);
  }
}

/** Make the controls show the player's state. */
function controls() {
  const { playing, direction, speed, loop } = player.state;
  $("play").classList.toggle("playing", playing);
  $("play").setAttribute("aria-label", playing ? "Pause" : "Play");
  press("reverse", direction < 0);
  $("speed").value = speed;
  $("loop").value = loop;
}

/** The frame next to a morph time. */
const nearest = (time) => times.reduce(
  (found, other, index) => (Math.abs(other - time) < Math.abs(times[found] - time) ? index : found), 0,
);

const go = (index) => player.seek(index).catch(fail);
const seek = (time) => go(nearest(time));

function stepBy(count) {
  player.pause();
  return go(player.state.index + count);
}

const toggle = () => (player.state.playing ? player.pause() : player.play());

function toggleField() {
  if (!scene.fields.length) return;
  arrows.state.visible = !arrows.state.visible;
  press("field", arrows.state.visible);
  $("field-note").hidden = !arrows.state.visible;
  arrows.draw(times[player.state.index]);
}

function saveFrame() {
  // The very bytes that stand in the page: nothing is encoded anew.
  const { index } = player.state;
  const data = frames.blob(index);
  const link = document.createElement("a");
  link.href = URL.createObjectURL(data);
  link.download = `frame-${String(index).padStart(4, "0")}.${data.type.split("/")[1]}`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

function changeSpeed(by) {
  const at = SPEEDS.indexOf(player.state.speed) + by;
  if (at >= 0 && at < SPEEDS.length) player.set("speed", SPEEDS[at]);
}

const reverse = () => player.set("direction", -player.state.direction);
const nextLoop = () => player.set("loop", LOOPS[(LOOPS.indexOf(player.state.loop) + 1) % LOOPS.length]);
const help = () => ($("help").open ? $("help").close() : $("help").showModal());

function landmarks() {
  if (!marks) return;
  if ($("marks").open) {
    $("marks").close();
    return;
  }
  player.pause();
  $("marks").showModal();
  marks.open().catch(fail);
}

async function copy(id, button) {
  const done = await copyText($(id));
  $(button).textContent = done ? "Copied" : "Press Ctrl+C";
  setTimeout(() => { $(button).textContent = "Copy"; }, 2000);
}

const KEYS = {
  " ": toggle,
  k: toggle,
  ArrowLeft: () => stepBy(-1),
  ArrowRight: () => stepBy(1),
  PageUp: () => stepBy(-10),
  PageDown: () => stepBy(10),
  Home: () => go(0),
  End: () => go(player.last),
  "+": () => stage.step(1),
  "=": () => stage.step(1),
  "-": () => stage.step(-1),
  0: () => stage.zoomTo(null),
  1: () => stage.zoomTo(1),
  f: toggleField,
  p: () => stage.setPixelated(!stage.view.pixelated),
  r: reverse,
  l: nextLoop,
  ",": () => changeSpeed(-1),
  ".": () => changeSpeed(1),
  m: landmarks,
  s: saveFrame,
  "?": help,
};
/** Keys that a focused element of this kind has a use of its own for. */
const OWN_KEYS = {
  BUTTON: [" "],
  SUMMARY: [" "],
  SELECT: [" ", "ArrowLeft", "ArrowRight", "PageUp", "PageDown", "Home", "End"],
};

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const name = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if ((OWN_KEYS[event.target.tagName] || []).includes(name)) return;
  if (event.target.tagName === "SELECT" && /^[a-z]$/.test(name)) return;
  if ($("help").open && name !== "?") return;
  if ($("marks").open) {
    const field = event.target.tagName === "TEXTAREA";
    if (["Delete", "Backspace"].includes(name) && !field) marks.remove();
    if (name !== "m" || field) return;
  }
  if (!KEYS[name]) return;
  event.preventDefault();
  KEYS[name]();
});

const ON_CLICK = {
  play: toggle,
  back: () => stepBy(-1),
  forward: () => stepBy(1),
  reverse,
  field: toggleField,
  pixels: KEYS.p,
  larger: KEYS["+"],
  smaller: KEYS["-"],
  zoom: () => stage.zoomTo(stage.view.scale === null ? 1 : null),
  save: saveFrame,
  "show-help": help,
  "hide-help": help,
  "show-marks": landmarks,
  "hide-marks": landmarks,
  "clear-marks": () => marks.clear(),
  "copy-line": () => copy("marks-line", "copy-line"),
  "copy-python": () => copy("marks-python", "copy-python"),
  first: KEYS.Home,
  final: KEYS.End,
};
for (const [id, action] of Object.entries(ON_CLICK)) $(id).addEventListener("click", action);
$("scrub").addEventListener("input", () => {
  player.pause();
  go(Number($("scrub").value));
});
$("speed").addEventListener("change", () => player.set("speed", Number($("speed").value)));
$("loop").addEventListener("change", () => player.set("loop", $("loop").value));
// Outside the panel is the dialog itself.
$("help").addEventListener("click", (event) => event.target === $("help") && help());

/** Small pictures of both ends beside the slider. */
async function thumbnail(id, index) {
  const bitmap = await frames.load(index);
  const canvas = $(id).querySelector("canvas");
  const factor = 88 / Math.max(bitmap.width, bitmap.height);
  canvas.width = Math.max(1, Math.round(bitmap.width * factor));
  canvas.height = Math.max(1, Math.round(bitmap.height * factor));
  const context = canvas.getContext("2d");
  context.imageSmoothingEnabled = factor < 1 || !scene.pixelated;
  context.imageSmoothingQuality = "high";
  context.drawImage(bitmap, 0, 0, canvas.width, canvas.height);
}

function begin() {
  $("scrub").max = player.last;
  for (const id of ["play", "back", "forward", "scrub", "reverse"]) $(id).disabled = player.last === 0;
  $("field").hidden = $("field-key").hidden = scene.fields.length === 0;
  $("show-marks").hidden = $("marks-key").hidden = !marks;
  $("charts").hidden = scene.curves.length === 0;
  const [a, b] = [scene.sizes[0], scene.sizes[player.last]].map(([width, height]) => `${width} \u00d7 ${height}`);
  const seconds = times.length / scene.fps + 2 * scene.hold;
  $("summary").textContent = `${a === b ? a : `${a} \u2192 ${b}`} pixels, ${times.length} frames, ${short(seconds)} s`;
  // Where one morph of a chain ends and the next begins.
  for (let time = Math.floor(times[0]) + 1; time < times[player.last] - 1e-9; time += 1) {
    const tick = element("i", { class: "tick" });
    tick.style.setProperty("--at", nearest(time) / player.last);
    $("scrub").after(tick);
  }
  for (const note of scene.notes) $("notes").append(element("li", {}, note));
  controls();
  return go(0).then(() => Promise.all([thumbnail("first", 0), thumbnail("final", player.last)])).catch(fail);
}

/** Play as soon as the page is seen, if its reader has nothing against motion. */
function autoplay() {
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) return;
  const observer = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    observer.disconnect();
    player.play();
  }, { threshold: 0.3 });
  observer.observe($("stage"));
}

/**
 * For scripts and tests.
 *
 * ready: promise that the first frame is shown; times: morph time of each frame;
 * index, time, playing, direction, speed, loop, zoom, pixelated, field: the state, to be read;
 * landmarks: the pairs of points that stand in the panel of landmarks, in pixels of both pictures;
 * seek(t), show(index): promises that the frame nearest to a time, or this one, is shown;
 * play(), pause(), and set(name, value) for "direction" (1, -1), "speed", "loop".
 */
window.clmorph = Object.freeze({
  ready: begin(),
  times: Object.freeze([...times]),
  get index() { return player.state.index; },
  get time() { return times[player.state.index]; },
  get playing() { return player.state.playing; },
  get direction() { return player.state.direction; },
  get speed() { return player.state.speed; },
  get loop() { return player.state.loop; },
  get zoom() { return stage.zoom(); },
  get pixelated() { return stage.view.pixelated; },
  get field() { return arrows.state.visible; },
  get landmarks() { return marks ? marks.pairs() : []; },
  seek,
  show: go,
  play: player.play,
  pause: player.pause,
  set: player.set,
});
window.clmorph.ready.then(autoplay);
