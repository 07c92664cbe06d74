// The studio: pictures and settings go to the server, previews and morphs come back.

const $ = (id) => document.getElementById(id);
/** Milliseconds without a change before a preview is asked for. */
const PAUSE = 60;
const state = {
  tab: "", pictures: [], number: 0, previewed: 0, running: null, shown: 0, settings: {}, view: null, coming: null,
  options: {}, timer: 0, ready: null, log: [],
};
const landmarks = makeLandmarks(() => { marked(); later(); });

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
  state.pictures = pictures;
  if (before !== pictures.map(({ key }) => key).join()) landmarks.clear();
  landmarks.detach();
  $("shown").replaceChildren();
  pictures.forEach((picture, index) => {
    const letter = String.fromCharCode(65 + index);
    const image = element("img", { src: of(`/pictures/${picture.key}/shown`), alt: `Picture ${letter}: ${picture.name}`, draggable: "false", class: picture.width < 128 ? "small" : "" });
    const frame = element("div", { class: "frame" }, image);
    const link = element("a", { href: of(`/pictures/${picture.key}`), download: picture.name, title: `${picture.name}, ${picture.width} × ${picture.height}` }, `${letter}: ${picture.name}`);
    const remove = element("button", { type: "button", "aria-label": `Remove picture ${letter}`, title: "Remove" }, "×");
    remove.addEventListener("click", () => tell(of(`/pictures/${picture.key}/remove`)));
    $("shown").append(element("li", {}, frame, element("div", { class: "caption" }, link, remove)));
    if (pictures.length === 2) landmarks.attach(index, frame, picture);
  });
  $("invitation").hidden = pictures.length >= 2;
  $("swap").disabled = pictures.length < 2;
  $("mark-help").hidden = pictures.length !== 2;
  marked();
  buttons();
  say("");
  if (pictures.length >= 2) later();
}

const tell = (path) => ask(path).then(took).catch((error) => fail(error.message));

function marked() {
  $("unmark").hidden = !landmarks.any;
}

// Settings

const controls = new Map();

function build({ presets, options, devices, downloads }) {
  for (const device of devices) $("device").append(element("option", { value: device.name }, device.label));
  for (const name of Object.keys(presets)) $("preset").append(element("option", { value: name }, name));
  const help = () => { $("preset-help").textContent = presets[$("preset").value]; };
  $("preset").addEventListener("change", () => { help(); later(); });
  $("device").addEventListener("change", later);
  help();
  let panel = "";
  for (const option of options) {
    const control = makeControl(option);
    controls.set(option.name, control);
    if (!option.main && option.panel !== panel) {
      panel = option.panel;
      $("other-options").append(element("h2", {}, panel));
    }
    $(option.main ? "main-options" : "other-options").append(control.row);
  }
  for (const ending of downloads) {
    const name = ending === "json" ? "Recipe" : ending.toUpperCase();
    const button = element("button", { type: "button", id: `get-${ending}` }, name);
    button.addEventListener("click", () => download(ending, button));
    $("downloads").append(button);
  }
}

/** A control of an option: an empty value is the preset's. */
function makeControl(option) {
  const id = `option-${option.name}`;
  const title = option.name.replaceAll("_", " ").replace(/^./, (letter) => letter.toUpperCase());
  const row = element("div", { class: "control" });
  row.append(element("label", { class: "name", for: id }, option.unit ? `${title} ` : title, ...(option.unit ? [element("small", {}, `(${option.unit})`)] : [])));
  const choices = option.flag ? ["yes", "no"] : option.choices;
  const input = choices ? element("select", { id }) : element("input", { id, type: "text", spellcheck: "false" });
  if (choices) for (const choice of ["", ...choices]) input.append(element("option", { value: choice }, choice || "preset's"));
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
      if (choices) input.options[0].textContent = `preset's: ${text}`;
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
    number, settings, preset: $("preset").value, device: $("device").value, landmarks: landmarks.pairs(),
  });
}

// Previews and runs

function later() {
  clearTimeout(state.timer);
  state.timer = setTimeout(preview, PAUSE);
}

async function preview() {
  if (state.pictures.length < 2) return;
  const number = (state.number += 1);
  state.log.push({ number, asked: performance.now() });
  try {
    const found = await ask(of("/preview"), asked(number));
    if (number !== state.number && state.running !== null) return;
    settled(found);
    if (state.running === null) say(found.before ? `waiting for ${found.before} task${found.before > 1 ? "s" : ""} of other tabs` : "preview …");
  } catch (error) {
    fail(error.message);
  }
}

function settled(found) {
  fail("");
  state.options = found.options;
  for (const [name, control] of controls) if (control.value() === undefined) control.usual(found.options[name]);
  $("command").value = found.command;
  $("python").value = found.python;
  $("copied").hidden = false;
}

async function run() {
  clearTimeout(state.timer);
  const number = (state.number += 1);
  state.running = number;
  $("downloads").hidden = true;
  buttons();
  try {
    const found = await ask(of("/run"), asked(number));
    settled(found);
    if (state.running === number && found.before) say(`waiting for ${found.before} task${found.before > 1 ? "s" : ""} of other tabs`);
  } catch (error) {
    state.running = null;
    buttons();
    fail(error.message);
  }
}

function buttons() {
  const busy = state.running !== null;
  $("run").disabled = busy || state.pictures.length < 2;
  $("cancel").hidden = $("progress").hidden = !busy;
  if (busy) $("progress").removeAttribute("value");
}

const say = (text) => { $("status").textContent = text; };

function heard(message) {
  const { type, number } = message;
  if (type === "progress" && number === state.running) {
    $("progress").value = message.share;
    const left = message.left === null ? "" : `, ${message.left} s left`;
    say(`${message.stage} ${Math.round(100 * message.share)} %${message.note ? ` (${message.note})` : ""}${left}`);
  } else if (type === "preview" && number === state.number) {
    show(message.url, number);
    if (message.last && state.running === null) say("preview");
  } else if (type === "result" && number === state.running) {
    state.running = null;
    buttons();
    show(message.url, number);
    $("downloads").hidden = false;
    say([`made in ${message.seconds} s; ${message.message}`, ...message.notes].join("; "));
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

/** Show a viewer's page in place of the one before, once it is ready, at the same time of the morph. */
function show(url, number) {
  state.coming?.remove();
  const frame = element("iframe", { src: url, title: "Viewer of the morph", class: "coming" });
  state.coming = frame;
  frame.addEventListener("load", async () => {
    const viewer = frame.contentWindow?.clmorph;
    if (!viewer || state.coming !== frame) return;
    await viewer.ready;
    const old = state.view?.contentWindow?.clmorph;
    if (old) {
      await viewer.seek(old.time);
      for (const name of ["loop", "speed"]) viewer.set(name, old[name]);
      if (!old.playing) viewer.pause();
    }
    if (state.coming !== frame) return;
    frame.classList.remove("coming");
    state.view?.remove();
    state.view = frame;
    state.coming = null;
    state.shown = number;
    $("empty").hidden = true;
    const entry = state.log.find((each) => each.number === number && !each.shown);
    if (entry) entry.shown = performance.now();
  });
  $("views").append(frame);
}

async function download(ending, button) {
  button.disabled = true;
  say(`writing morph.${ending}`);
  try {
    const answer = await fetch(of(`/files/${ending}`));
    if (!answer.ok) throw new Error((await answer.json()).line);
    const url = URL.createObjectURL(await answer.blob());
    const link = element("a", { href: url, download: `morph.${ending}` });
    link.click();
    setTimeout(() => URL.revokeObjectURL(url), 60000);
    say(`morph.${ending}`);
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
$("samples").addEventListener("click", () => tell(of("/samples")));
$("swap").addEventListener("click", () => tell(of("/swap")));
$("unmark").addEventListener("click", () => { landmarks.clear(); marked(); later(); });
$("run").addEventListener("click", run);
$("cancel").addEventListener("click", () => {
  say("cancelling");
  ask(of("/cancel"), undefined).catch(() => {});
});
$("reset").addEventListener("click", () => {
  for (const control of controls.values()) control.reset();
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
window.addEventListener("pagehide", () => navigator.sendBeacon(of("/close")));
window.addEventListener("pageshow", (event) => { if (event.persisted) location.reload(); });

async function begin() {
  const found = await ask("/tabs");
  state.tab = found.tab;
  build(found);
  const events = new EventSource(of("/events"));
  events.addEventListener("message", (event) => heard(JSON.parse(event.data)));
  await new Promise((resolve) => { events.addEventListener("open", resolve, { once: true }); });
}

/** For scripts and tests: ready, and the state, to be read. */
window.studio = { ready: begin().catch((error) => fail(error.message)), state, landmarks };
