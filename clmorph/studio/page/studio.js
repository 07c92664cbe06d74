// The studio: pictures and settings go to the server, previews and morphs come back.

const $ = (id) => document.getElementById(id);
/** Milliseconds without a change before a preview is asked for. */
const PAUSE = 60;
const state = {
  tab: "", pictures: [], number: 0, running: null, shown: 0, view: null, coming: null, timer: 0, log: [],
  kind: null, asks: new Map(), viewed: null, heard: -1, told: -1, ran: null, history: [], zoom: [1, 1],
};
/** What a page that is loaded again knows of the one before; it goes with the browser's tab. */
const KEPT = "clmorph-studio";
/** Largest number of steps that can be undone, and largest zoom of a picture. */
const MOST_STEPS = 100, MOST_ZOOM = 16;
const landmarks = makeLandmarks(() => { marked(); later(); });
const brush = makeBrush(painted);
const compare = makeCompare(
  document.getElementById("views"),
  () => (state.view?.tagName === "IFRAME" ? state.view : null),
  () => state.pictures.map(({ key }) => of(`/pictures/${key}/shown`)),
);

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

function fail(line) {
  $("failure").textContent = line || "";
  $("failure").hidden = !line;
}

/** Ask the server; an error becomes a line on the page. */
async function ask(path, body, method = "POST") {
  let answer;
  try {
    answer = await fetch(path, { method, body });
  } catch {
    throw new Error("error: the studio does not answer; start clmorph studio again, and load this page again");
  }
  const type = answer.headers.get("content-type") || "";
  const found = type.startsWith("application/json") ? await answer.json() : { line: await answer.text() };
  if (!answer.ok) throw new Error(found.line);
  return found;
}

const of = (path) => `/tabs/${state.tab}${path}`;

// Pictures

async function add(files) {
  await studio.ready;
  fail("");
  for (const file of files) {
    try {
      say(`reading ${file.name}`);
      if (file.size > 64 * 2 ** 20) {
        // The server would refuse it, too, but only after the browser has sent it.
        throw new Error(`error: ${file.name}: more than 67 MB; expected a smaller file`);
      }
      took(await ask(of(`/pictures?name=${encodeURIComponent(file.name || "pasted.png")}`), file));
    } catch (error) {
      say("");
      fail(error.message);
      return;
    }
  }
}

function took({ pictures }) {
  const before = state.pictures.map(({ key }) => key).join();
  const others = before !== pictures.map(({ key }) => key).join();
  state.pictures = pictures;
  if (others) {
    landmarks.forget();
    state.history = [];
    state.zoom = [1, 1];
    state.viewed = null; // other pictures are no other settings
    $("stale").hidden = state.ran === null;
    compare.clear();
    over(state.view?.tagName === "IFRAME");
  }
  landmarks.detach();
  brush.detach();
  $("shown").replaceChildren();
  pictures.forEach((picture, index) => {
    const letter = String.fromCharCode(65 + index);
    const image = element("img", { src: of(`/pictures/${picture.key}/shown`), alt: `Picture ${letter}: ${picture.name}`, draggable: "false", class: picture.width < 128 ? "small" : "" });
    const frame = element("div", { class: "frame" }, image);
    const link = element("a", { href: of(`/pictures/${picture.key}`), download: picture.name, title: `${picture.name}, ${picture.width} × ${picture.height}` }, `${letter}: ${picture.name}`);
    const remove = element("button", { type: "button", "aria-label": `Remove picture ${letter}`, title: "Remove" }, "×");
    remove.addEventListener("click", () => tell(() => of(`/pictures/${picture.key}/remove`)));
    const pane = element("div", { class: "window" }, frame);
    const zooms = pictures.length === 2 ? zoomers(index, pane, frame, image, picture) : [];
    const notes = picture.notes.map((note) => element("small", { class: "note" }, note));
    $("shown").append(element("li", {}, pane, element("div", { class: "caption" }, link, ...zooms, remove), ...notes));
    if (pictures.length === 2) {
      landmarks.attach(index, frame, picture);
      brush.attach(index, frame, picture);
    }
  });
  $("invitation").hidden = pictures.length >= 2;
  $("swap").disabled = pictures.length < 2;
  guides();
  const { painted: regions } = state.kind;
  if (brush.any && pictures.slice(0, regions === "mask" ? 1 : 2).some((each) => !each.painted[regions])) painted(0);
  files();
  marked();
  buttons();
  say("");
  if (pictures.length >= 2) later();
  if (others) find();
}

/** Buttons that enlarge a picture, so that points can be set in its single pixels. */
function zoomers(side, pane, frame, image, picture) {
  const letter = "AB"[side];
  const show = (factor) => {
    // What is in the middle stays there.
    const x = (pane.scrollLeft + pane.clientWidth / 2) / frame.clientWidth;
    const y = (pane.scrollTop + pane.clientHeight / 2) / frame.clientHeight;
    state.zoom[side] = Math.min(Math.max(factor, 1), MOST_ZOOM);
    const large = state.zoom[side] > 1;
    pane.parentElement.classList.toggle("wide", large);
    pane.style.height = large ? `${(pane.clientWidth * picture.height) / picture.width}px` : "";
    frame.style.width = `${100 * state.zoom[side]}%`;
    pane.scrollTo(x * frame.clientWidth - pane.clientWidth / 2, y * frame.clientHeight - pane.clientHeight / 2);
    if (state.zoom[side] > 1 && Math.max(picture.width, picture.height) > 640) image.src = of(`/pictures/${picture.key}/large`);
    image.classList.toggle("small", picture.width < 128 || image.clientWidth > 3 * picture.width);
    smaller.disabled = state.zoom[side] === 1;
    larger.disabled = state.zoom[side] === MOST_ZOOM;
  };
  const [smaller, larger] = [["\u2212", "Reduce", 0.5], ["+", "Enlarge", 2]].map(([text, what, factor]) => {
    const button = element("button", { type: "button", "aria-label": `${what} picture ${letter}`, title: what }, text);
    button.addEventListener("click", () => show(state.zoom[side] * factor));
    return button;
  });
  smaller.disabled = true;
  return [smaller, larger];
}

/** Ask for the landmarks that the pictures show, and draw them. */
async function find() {
  $("found").hidden = true;
  if (state.pictures.length !== 2) return;
  const keys = state.pictures.map(({ key }) => key).join();
  try {
    const { pairs, text } = await ask(of("/found"));
    if (keys !== state.pictures.map(({ key }) => key).join()) return;
    landmarks.found(pairs);
    $("found").textContent = text ? `Landmarks: ${text}.` : "";
    marked();
    keep();
  } catch (error) {
    fail(error.message);
  }
}

const tell = (path) => studio.ready.then(() => ask(path())).then(took).catch((error) => fail(error.message));

function marked() {
  const used = state.kind.landmarks && state.pictures.length === 2;
  $("unmark").hidden = !landmarks.any || !used;
  $("remark").hidden = landmarks.untouched || !landmarks.known || !used;
  $("found").hidden = !used || !landmarks.known;
}

/** Show what guides this kind of work: landmarks, the brush, or both by choice. */
function guides() {
  const { kind } = state;
  const two = state.pictures.length === 2;
  const both = kind.landmarks && kind.painted !== "";
  $("guide").hidden = !two || !both;
  const brushing = two && kind.painted !== "" && (!both || $("use-brush").checked);
  brush.use(kind.painted, brushing);
  $("colors").classList.toggle("one", kind.painted === "mask");
  $("brush").hidden = !brushing;
  landmarks.use(two && kind.landmarks && !brushing);
  $("mark-help").hidden = !two || (!brushing && !kind.landmarks);
  $("mark-help").textContent = !brushing
    ? "Landmarks: click a point of A, then the point of B where it belongs. Drag a point to move it; Delete removes it."
    : kind.painted === "mask"
      ? "Paint what is to be recolored; without paint it is all of the picture."
      : "Paint what belongs together in one color, on both pictures: each color goes only into itself, and so does what is not painted. Balanced presets get a reach then, as regions differ in size.";
}

/** Painted regions are sent one after the other; previews and runs wait for them. */
let sent = Promise.resolve();

/** Send painted regions as they are now, and show what follows from them. */
function painted(side) {
  const regions = state.kind.painted;
  const blank = !brush.any;
  const sides = state.pictures.slice(0, regions === "mask" ? 1 : 2)
    .map(({ key }, index) => ({ key, changed: index === side, body: blank ? "" : brush.png(index) }));
  sent = sent.then(async () => {
    for (const { key, changed, body } of sides) {
      const picture = state.pictures.find((each) => each.key === key);
      // Both pictures have regions, or none has; an empty canvas is one without paint.
      if (!picture || (!changed && !blank && picture.painted[regions])) continue;
      const { pictures } = await ask(of(`/pictures/${key}/painted/${regions}`), await body);
      picture.painted = pictures.find((each) => each.key === key)?.painted ?? {};
    }
    files();
    later();
  }).catch((error) => fail(error.message));
}

/** Links to the files with painted regions, which the command needs beside the pictures. */
function files() {
  const { kind } = state;
  $("unpaint").disabled = $("unpaint-last").disabled = !brush.any;
  $("painted-files").replaceChildren();
  for (const picture of state.pictures) {
    const name = kind.painted && picture.painted[kind.painted];
    if (!name) continue;
    const path = of(`/pictures/${picture.key}/painted/${kind.painted}`);
    $("painted-files").append(element("a", { href: path, download: name }, name), " ");
  }
}

// Settings

let controls = new Map();

function build({ kinds, devices }) {
  for (const device of devices) $("device").append(element("option", { value: device.name }, device.label));
  $("device").addEventListener("change", later);
  $("preset").addEventListener("change", () => { presetHelp(); later(); });
  $("grid").addEventListener("input", later);
  for (const kind of kinds) {
    kind.controls = new Map();
    kind.rows = { main: [], other: [] };
    let panel = "";
    for (const option of kind.options) {
      const control = makeControl(option);
      control.usual(option.usual);
      kind.controls.set(option.name, control);
      if (!option.main && option.panel !== panel) {
        panel = option.panel;
        kind.rows.other.push(element("h2", {}, panel));
      }
      kind.rows[option.main ? "main" : "other"].push(control.row);
    }
    const tab = element("button", { type: "button", role: "tab", id: `kind-${kind.name}`, "aria-controls": "panel" }, kind.title);
    tab.addEventListener("click", () => choose(kind));
    tab.addEventListener("keydown", (event) => {
      const at = kinds.indexOf(kind);
      const to = { ArrowLeft: at - 1, ArrowRight: (at + 1) % kinds.length, Home: 0, End: -1 }[event.key];
      if (to === undefined) return;
      const next = kinds.at(to);
      choose(next);
      $(`kind-${next.name}`).focus();
      event.preventDefault();
    });
    $("kinds").append(tab);
  }
  const named = () => kinds.find(({ name }) => `#${name}` === location.hash);
  window.addEventListener("hashchange", () => choose(named() || kinds[0]));
  choose(named() || kinds[0]);
}

/** Say what the preset does; of auto also what it chose. */
function presetHelp(chosen = "") {
  const { presets } = state.kind;
  const name = $("preset").value;
  $("preset-help").textContent = name === "auto" && chosen ? `The pictures choose ${chosen}: ${presets[chosen]}` : presets[name] || "";
}

/** Go to a tab: its controls take the place of those before; the pictures stay. */
function choose(kind) {
  if (state.kind === kind) return;
  if (state.running !== null) ask(of("/cancel"), undefined).catch(() => {});
  state.running = null;
  state.told = state.number += 1; // what is on its way for the tab before is not shown
  state.kind = kind;
  controls = kind.controls;
  fail("");
  for (const tab of $("kinds").children) {
    const chosen = tab.id === `kind-${kind.name}`;
    tab.setAttribute("aria-selected", String(chosen));
    tab.tabIndex = chosen ? 0 : -1;
  }
  $("panel").setAttribute("aria-label", kind.title);
  $("kind-help").textContent = kind.help;
  if (location.hash.slice(1) !== kind.name) history.replaceState(null, "", `#${kind.name}`);
  $("run").textContent = kind.action;
  $("main-options").replaceChildren(...kind.rows.main);
  $("other-options").replaceChildren(...kind.rows.other);
  const preset = $("preset").value;
  $("preset").replaceChildren(...Object.keys(kind.presets).map((name) => element("option", { value: name }, name)));
  if (preset in kind.presets) $("preset").value = preset;
  $("preset-row").hidden = !Object.keys(kind.presets).length;
  presetHelp();
  $("grid-row").hidden = !kind.grid;
  const stills = kind.downloads.includes("gif") ? ["still"] : [];
  const named = { json: "Recipe", still: "Still (PNG)" };
  $("downloads").replaceChildren($("stale"), ...[...kind.downloads, ...stills].map((ending) => {
    const button = element("button", { type: "button", id: `get-${ending}` }, named[ending] || ending.toUpperCase());
    if (ending === "still") button.title = "The frame that the film shows now";
    button.addEventListener("click", () => download(ending, button));
    return button;
  }));
  $("downloads").hidden = $("copied").hidden = true;
  state.coming?.remove();
  state.view?.remove();
  state.coming = state.view = null;
  state.viewed = null;
  compare.clear();
  over(false);
  $("empty").hidden = false;
  guides();
  marked();
  files();
  buttons();
  say("");
  later();
}

/** A control of an option; an empty value is the default. */
function makeControl(option) {
  const id = `option-${option.name}`;
  const title = option.name.replaceAll("_", " ").replace(/^./, (letter) => letter.toUpperCase());
  const row = element("div", { class: "control" });
  row.append(element("label", { class: "name", for: id }, option.unit ? `${title} ` : title, ...(option.unit ? [element("small", {}, `(${option.unit})`)] : [])));
  const choices = option.flag ? ["yes", "no"] : option.choices;
  const input = choices ? element("select", { id }) : element("input", { id, type: "text", spellcheck: "false" });
  if (choices) for (const choice of ["", ...choices]) input.append(element("option", { value: choice }, choice || "default"));
  row.append(input);
  let slider = null;
  if (option.slider) {
    const { low, high, multiplies, whole } = option.slider;
    slider = element("input", { type: "range", min: "0", max: "1", step: "0.001", "aria-label": `${title}, as a slider` });
    const digits = (value) => (whole ? String(Math.round(value)) : String(Number(value.toPrecision(2))));
    slider.addEventListener("input", () => {
      const part = Number(slider.value);
      input.value = digits(multiplies ? low * (high / low) ** part : low + (high - low) * part);
      changed();
    });
    slider.place = (value) => {
      const number = Number(value);
      if (value === "" || !Number.isFinite(number)) return;
      slider.value = multiplies ? Math.log(number / low) / Math.log(high / low) : (number - low) / (high - low);
      slider.setAttribute("aria-valuetext", `${value} ${option.unit}`);
    };
    row.append(slider);
  }
  if (option.name === "reach") {
    const box = element("input", { type: "checkbox", id: "balanced" });
    box.addEventListener("change", () => {
      input.value = box.checked ? option.word : "";
      changed();
    });
    row.append(element("label", { class: "tick", for: "balanced" }, box, "balanced: nothing fades"));
    row.balanced = box;
  }
  row.append(element("small", {}, option.help));
  input.setAttribute("aria-description", option.help);
  function changed() {
    slider?.place(input.value);
    if (row.balanced) row.balanced.checked = (input.value || input.placeholder) === option.word;
    later();
  }
  input.addEventListener("input", changed);
  return {
    row, input,
    value() {
      if (input.value.trim() === "") return undefined;
      return option.flag ? input.value === "yes" : input.value.trim();
    },
    usual(value) {
      const text = value === true ? "yes" : value === false ? "no" : Array.isArray(value) ? value.join(option.name === "canvas" ? "x" : ",") : String(value ?? "");
      if (choices) input.options[0].textContent = `default: ${text}`;
      else input.placeholder = text;
      if (input.value === "") {
        slider?.place(text);
        if (row.balanced) row.balanced.checked = text === option.word;
      }
    },
    reset() { input.value = ""; },
  };
}

function asked(number) {
  const settings = {};
  for (const [name, control] of controls) {
    const value = control.value();
    if (value !== undefined) settings[name] = value;
  }
  return JSON.stringify({
    number, settings, kind: state.kind.name, preset: $("preset").value || undefined, device: $("device").value,
    grid: $("grid").value, landmarks: landmarks.untouched ? "auto" : landmarks.pairs(), painted: state.kind.painted !== "" && brush.any,
    strokes: brush.strokes,
  });
}

/** What is asked, kept by its number until it is shown. */
function remembered(number) {
  const body = asked(number);
  for (const old of state.asks.keys()) if (old < number - 20) state.asks.delete(old);
  state.asks.set(number, { body, options: {}, pictures: state.pictures.map(({ key }) => key).join() });
  return body;
}

/** Say whether the files are those of a run with other settings or pictures than the command. */
function stale() {
  const now = state.asks.get(state.number) ?? null;
  $("stale").hidden = !difference(state.ran, now);
}

function known(number, { options }) {
  if (state.asks.has(number)) state.asks.get(number).options = options;
}

/** The settings that differ, in a few words; "" if none does. */
function difference(before, now) {
  if (!before || !now) return "";
  const [old, other] = [JSON.parse(before.body), JSON.parse(now.body)];
  const words = [];
  for (const name of new Set([...Object.keys(old.settings), ...Object.keys(other.settings)])) {
    if (old.settings[name] === other.settings[name]) continue;
    const value = old.settings[name] ?? before.options[name] ?? "as usual";
    words.push(`${name.replaceAll("_", " ")} ${value === true ? "yes" : value === false ? "no" : value}`);
  }
  if (before.pictures !== now.pictures) words.push("other pictures");
  if (old.grid !== other.grid) words.push(`grid ${old.grid || "as usual"}`);
  if (old.preset !== other.preset) words.push(`preset ${old.preset}`);
  if (old.device !== other.device) words.push(`device ${old.device}`);
  if (JSON.stringify(old.landmarks) !== JSON.stringify(other.landmarks)) words.push("other landmarks");
  if (old.strokes !== other.strokes) words.push("other regions");
  return words.length ? `before: ${words.slice(0, 3).join(", ")}` : "";
}

// Undo, and what is kept for a page that is loaded again

/** All that was set, as text: values by name, landmarks, and for which kind and pictures. */
function setting() {
  const values = {};
  for (const [name, control] of controls) if (control.input.value !== "") values[name] = control.input.value;
  return JSON.stringify({
    kind: state.kind.name, values, preset: $("preset").value, grid: $("grid").value,
    landmarks: landmarks.untouched ? null : landmarks.pairs(),
  });
}

function restore(text) {
  const { values, preset, grid, landmarks: pairs } = JSON.parse(text);
  for (const [name, control] of controls) control.input.value = values[name] ?? "";
  if (preset in state.kind.presets) $("preset").value = preset;
  $("grid").value = grid;
  if (pairs === null) landmarks.back();
  else landmarks.set(pairs);
  presetHelp();
  marked();
}

/** Note what is set now, as a step that can be undone. */
function remember() {
  const now = setting();
  const last = state.history.at(-1);
  if (last && JSON.parse(last).kind !== state.kind.name) state.history = [];
  if (state.history.at(-1) !== now) state.history.push(now);
  if (state.history.length > MOST_STEPS) state.history.shift();
  $("undo").disabled = state.history.length < 2;
  keep();
}

function undo() {
  if (state.history.length < 2) return;
  state.history.pop();
  restore(state.history.at(-1));
  later();
}

function keep() {
  if (state.tab) sessionStorage.setItem(KEPT, JSON.stringify({ tab: state.tab, number: state.number, setting: setting() }));
}

/** Whether something would be lost with the page. */
const precious = () => state.running !== null || (state.ran !== null && !state.saved) || !landmarks.untouched || brush.any;

// Previews and runs

function later() {
  clearTimeout(state.timer);
  state.timer = setTimeout(preview, PAUSE);
}

const enough = () => state.pictures.length >= 2 && state.pictures.length <= state.kind.most;

async function preview() {
  remember();
  if (state.pictures.length < 2) return;
  const number = (state.number += 1);
  state.log.push({ number, asked: performance.now() });
  fail("");
  try {
    await sent;
    if (number !== state.number) return;
    const found = await ask(of("/preview"), remembered(number));
    known(number, found);
    settled(found, number);
    stale();
    if (state.running === null && state.heard < number) say(found.before ? `waiting for ${found.before} task${found.before > 1 ? "s" : ""} of other tabs` : "preview …");
  } catch (error) {
    fail(error.message);
  }
}

/** Show the defaults and the command of a request, unless later ones are there. */
function settled(found, number) {
  if (number < state.told) return;
  for (const [name, control] of controls) if (control.value() === undefined) control.usual(found.options[name]);
  presetHelp(found.preset);
  if (number === state.told) return; // the command came with the result
  state.told = number;
  $("command").value = found.command;
  $("python").value = found.python;
  $("copied").hidden = false;
}

async function run() {
  clearTimeout(state.timer);
  remember(); // what was set just before, too
  const number = (state.number += 1);
  state.running = number;
  $("downloads").hidden = true;
  fail("");
  buttons();
  try {
    await sent;
    if (state.running !== number) return; // another tab was chosen
    clearTimeout(state.timer);
    const found = await ask(of("/run"), remembered(number));
    known(number, found);
    state.ran = state.asks.get(number);
    settled(found, number);
    if (state.running === number && found.before) say(`waiting for ${found.before} task${found.before > 1 ? "s" : ""} of other tabs`);
  } catch (error) {
    state.running = null;
    buttons();
    fail(error.message);
  }
}

function buttons() {
  const busy = state.running !== null;
  $("run").disabled = busy || !enough();
  $("cancel").hidden = $("progress").hidden = !busy;
  if (busy) $("progress").removeAttribute("value");
}

const say = (text) => { $("status").textContent = text; };

function heard(message) {
  const { type, number } = message;
  // An event can come before the answer to the request that it belongs to.
  if (type !== "progress") state.heard = Math.max(state.heard, number);
  if (type === "progress" && number === state.running) {
    $("progress").value = message.share;
    const left = message.left === null ? "" : `, ${message.left} s left`;
    say(`${message.stage} ${Math.round(100 * message.share)} %${message.note ? ` (${message.note})` : ""}${left}`);
  } else if (type === "preview" && number === state.number) {
    show(message, number);
    if (message.last && state.running === null) say("preview");
  } else if (type === "result" && number === state.running) {
    state.running = null;
    state.saved = false;
    buttons();
    show(message, number);
    $("downloads").hidden = false;
    $("stale").hidden = true;
    if (message.command && number >= state.told) {
      // The answer to the request, which does not know the limit of memory, can still come.
      state.told = number;
      [$("command").value, $("python").value] = [message.command, message.python];
      $("copied").hidden = false;
    }
    say([`made in ${message.seconds} s`, message.message, ...message.notes].filter(Boolean).join("; "));
  } else if (type === "error" && (number === state.number || number === state.running)) {
    if (number === state.running) state.running = null;
    buttons();
    say("");
    fail(message.line);
  } else if (type === "cancelled" && message.of === "run" && number === state.running) {
    state.running = null;
    buttons();
    say("cancelled");
  }
}

/** Show a result in place of the one before, once it is ready; a film at the same time as that. */
function show({ url, film, unmatched }, number) {
  state.coming?.remove();
  const view = film ? element("iframe", { src: url, title: "Viewer", class: "coming" }) : still(url);
  state.coming = view;
  const ready = async () => {
    const viewer = view.contentWindow?.clmorph;
    if ((film && !viewer) || state.coming !== view) return;
    if (film) await viewer.ready;
    const old = state.view?.contentWindow?.clmorph;
    if (film && old) {
      await viewer.seek(old.time);
      for (const name of ["loop", "speed"]) viewer.set(name, old[name]);
      if (!old.playing) viewer.pause();
    }
    if (state.coming !== view) return;
    view.classList.remove("coming");
    const now = state.asks.get(number) ?? null;
    const label = difference(state.viewed, now);
    if (film && old && label) compare.keep(state.view, label);
    else state.view?.remove();
    state.view = view;
    state.viewed = now;
    compare.film(number, unmatched);
    over(film);
    state.coming = null;
    state.shown = number;
    $("empty").hidden = true;
    const entry = state.log.find((each) => each.number === number && !each.shown);
    if (entry) entry.shown = performance.now();
  };
  (film ? view : view.querySelector("img.result")).addEventListener("load", ready);
  $("views").append(view);
}

/** Offer what can be laid over a film. */
function over(film) {
  const modes = compare.modes;
  for (const option of $("over").options) option.disabled = option.value !== "none" && !modes[option.value];
  if ($("over").selectedOptions[0].disabled) $("over").value = "none";
  $("over-row").hidden = !film;
  $("legend").hidden = $("over").value !== "masses";
  compare.choose(film ? $("over").value : "none");
}

/** A picture; beside what it was made of, if that has the same place. */
function still(url) {
  const box = element("div", { class: "still" });
  const result = element("img", { src: url, class: "result", alt: `${state.kind.title}: the result` });
  const view = element("div", { class: "still-view coming" }, box);
  box.append(result);
  if (state.kind.name === "recolor") {
    const [{ width, height }] = state.pictures;
    box.style.width = `min(100%, calc((100dvh - 13rem) * ${width / height}))`;
    const before = element("img", { src: of(`/pictures/${state.pictures[0].key}/shown`), class: "before", alt: "Picture A as it was" });
    const divider = element("input", { type: "range", class: "divider", min: "0", max: "100", value: state.divider ?? "0", "aria-label": "Divider: the picture as it was stands at its left" });
    const place = () => {
      state.divider = divider.value;
      before.style.clipPath = `inset(0 ${100 - Number(divider.value)}% 0 0)`;
      box.style.setProperty("--at", `${divider.value}%`);
    };
    divider.addEventListener("input", place);
    box.append(before, divider);
    place();
  }
  return view;
}

async function download(ending, button) {
  button.disabled = true;
  const time = ending === "still" ? state.view?.contentWindow?.clmorph?.time ?? 0 : null;
  const name = time === null ? `${state.kind.output}.${ending}` : `${state.kind.output}-${time.toFixed(2)}.png`;
  say(`writing the ${ending === "json" ? "recipe" : time === null ? ending.toUpperCase() : "still"}`);
  try {
    const answer = await fetch(of(time === null ? `/files/${ending}` : `/still?time=${time}`));
    if (!answer.ok) throw new Error((await answer.json()).line);
    const url = URL.createObjectURL(await answer.blob());
    const link = element("a", { href: url, download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(url), 60000);
    state.saved = true;
    say(name);
  } catch (error) {
    say("");
    fail(error.message);
  }
  button.disabled = false;
}

// Events of the page

$("choose").addEventListener("change", async () => {
  await add([...$("choose").files]);
  $("choose").value = "";
});
$("samples").addEventListener("click", () => tell(() => of("/samples")));
$("swap").addEventListener("click", () => tell(() => of("/swap")));
$("unmark").addEventListener("click", () => { landmarks.clear(); marked(); later(); });
$("remark").addEventListener("click", () => { landmarks.back(); marked(); later(); });
$("undo").addEventListener("click", undo);
document.addEventListener("keydown", (event) => {
  if (!(event.ctrlKey || event.metaKey) || event.shiftKey || event.key.toLowerCase() !== "z") return;
  if (event.target.matches("input[type=text], textarea")) return; // it has an undo of its own
  undo();
  event.preventDefault();
});
$("over").addEventListener("change", () => over(true));
$("guide").addEventListener("change", guides);
$("unpaint").addEventListener("click", () => brush.clear());
$("unpaint-last").addEventListener("click", () => brush.undo());
$("run").addEventListener("click", run);
$("cancel").addEventListener("click", () => {
  say("cancelling");
  ask(of("/cancel"), undefined).catch(() => {});
});
$("reset").addEventListener("click", () => {
  for (const control of controls.values()) control.reset();
  $("grid").value = "";
  later();
});
$("controls").addEventListener("submit", (event) => event.preventDefault());
for (const name of ["command", "python"]) {
  $(`copy-${name}`).addEventListener("click", async () => {
    await navigator.clipboard?.writeText($(name).value).catch(() => {});
    $(name).select();
    say("copied");
  });
}
document.addEventListener("dragover", (event) => { event.preventDefault(); $("drop").classList.add("over"); });
document.addEventListener("dragleave", (event) => { if (!event.relatedTarget) $("drop").classList.remove("over"); });
document.addEventListener("drop", (event) => {
  event.preventDefault();
  $("drop").classList.remove("over");
  add([...event.dataTransfer.files]);
});
document.addEventListener("paste", (event) => {
  const files = [...event.clipboardData.files];
  if (files.length) add(files);
});
window.addEventListener("pagehide", () => navigator.sendBeacon(of("/leave")));
window.addEventListener("beforeunload", (event) => { if (precious()) event.preventDefault(); });
window.addEventListener("pageshow", (event) => { if (event.persisted) location.reload(); });

async function begin() {
  const kept = JSON.parse(sessionStorage.getItem(KEPT) ?? "{}");
  const found = await ask(`/tabs?again=${encodeURIComponent(kept.tab ?? "")}`);
  state.tab = found.tab;
  build(found);
  const events = new EventSource(of("/events"));
  events.addEventListener("message", (event) => heard(JSON.parse(event.data)));
  await new Promise((resolve) => { events.addEventListener("open", resolve, { once: true }); });
  if (found.tab === kept.tab) again(found, kept);
}

/** Show what the page before had: its pictures, settings, landmarks and result. */
function again({ pictures, result }, { number, setting: before }) {
  state.number = Math.max(state.number, number, result?.number ?? 0);
  if (JSON.parse(before).kind === state.kind.name) restore(before);
  const own = JSON.parse(before).landmarks;
  if (pictures.length) took({ pictures });
  if (own !== null) landmarks.set(own);
  if (result === null || result.of !== state.kind.name) return;
  if (result.number < number) { // a preview of later settings comes
    $("downloads").hidden = $("stale").hidden = false;
    return;
  }
  clearTimeout(state.timer); // the result stays, in place of a preview
  state.running = result.number;
  remembered(result.number);
  state.ran = state.asks.get(result.number);
  heard({ ...result, type: "result" });
  state.saved = true; // it is kept
}

/** For scripts and tests: ready, and the state, to be read. */
window.studio = { ready: null, state, landmarks, brush, compare };
studio.ready = begin().catch((error) => fail(error.message));
