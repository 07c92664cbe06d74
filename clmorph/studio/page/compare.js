// Layers over the film: a plain cross-fade or the settings before, at the right of a divider, and
// the mass that is destroyed and created.

/**
 * Layers over the viewer.
 *
 * host: the element that holds the viewer's frame.
 * view(): the frame that is shown, an iframe or null; pictures(): addresses of the pictures.
 */
function makeCompare(host, view, pictures) {
  const sum = element("div", { class: "sum" });
  const fade = element("div", { class: "fade" }, sum);
  const right = element("div", { class: "right" }, fade);
  const masses = element("div", { class: "masses" });
  const divider = element("div", { class: "cut", role: "slider", tabindex: "0", "aria-label": "Divider of the comparison", "aria-valuemin": "0", "aria-valuemax": "100", "aria-orientation": "horizontal" });
  const names = [element("span", { class: "side left-side" }), element("span", { class: "side right-side" })];
  const stage = element("div", { class: "over" }, masses, right, ...names, divider);
  const layer = element("div", { class: "compare", hidden: "" }, stage);
  host.append(layer);

  const state = { mode: "none", at: 50, previous: null, label: "", unmatched: [], shown: "", running: false };

  function drag(event) {
    const box = stage.getBoundingClientRect();
    place(((event.clientX - box.left) / box.width) * 100);
  }

  function place(value) {
    state.at = Math.max(0, Math.min(100, value));
    divider.style.left = `${state.at}%`;
    divider.setAttribute("aria-valuenow", String(Math.round(state.at)));
    right.style.clipPath = `inset(0 0 0 ${state.at}%)`;
  }

  divider.addEventListener("pointerdown", (event) => { divider.setPointerCapture(event.pointerId); event.preventDefault(); divider.focus(); });
  divider.addEventListener("pointermove", (event) => { if (divider.hasPointerCapture(event.pointerId)) drag(event); });
  divider.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -2, ArrowRight: 2, Home: -100, End: 100 }[event.key];
    if (!step) return;
    place(state.at + step);
    event.preventDefault();
  });
  place(state.at);

  /** The two pictures of a cross-fade at a time of the film, or the masses of its part. */
  function two(parent, addresses, key) {
    if (parent.dataset.key === key) return parent.children;
    parent.replaceChildren(...addresses.map((src) => element("img", { src, alt: "", draggable: "false" })));
    parent.dataset.key = key;
    return parent.children;
  }

  function cover(element, box, outer) {
    element.style.left = `${box.left - outer.left}px`;
    element.style.top = `${box.top - outer.top}px`;
    element.style.width = `${box.width}px`;
    element.style.height = `${box.height}px`;
  }

  /** Keep the layers where the film is, and at its time. */
  function follow() {
    if (!state.running) return;
    requestAnimationFrame(follow);
    const frame = view();
    const inner = frame?.contentWindow;
    const viewer = inner?.clmorph;
    layer.hidden = !viewer;
    if (!viewer) return;
    const page = inner.document;
    const outer = page.getElementById("stage").getBoundingClientRect();
    const box = page.getElementById("box").getBoundingClientRect();
    const edge = 1; // the border of the frame
    layer.style.width = `${frame.offsetWidth}px`;
    layer.style.height = `${frame.offsetHeight}px`;
    stage.style.left = `${outer.left + edge}px`;
    stage.style.top = `${outer.top + edge}px`;
    stage.style.width = `${outer.width}px`;
    stage.style.height = `${outer.height}px`;
    const time = viewer.time;
    const part = Math.max(0, Math.min(pictures().length - 2, Math.floor(time)));
    const t = time - part;
    const pixelated = viewer.pixelated ? "pixelated" : "auto";
    masses.hidden = state.mode !== "masses" || !state.unmatched[part];
    if (!masses.hidden) {
      cover(masses, box, outer);
      const [gone, come] = two(masses, state.unmatched[part], `${state.shown}/${part}`);
      [gone.style.opacity, come.style.opacity] = [1 - t, t];
      gone.style.imageRendering = come.style.imageRendering = pixelated;
    }
    const compared = state.mode === "fade" || (state.mode === "previous" && state.previous);
    for (const each of [right, divider, ...names]) each.hidden = !compared;
    fade.hidden = state.mode !== "fade";
    if (state.mode === "fade") {
      cover(fade, box, outer);
      fade.style.background = inner.getComputedStyle(page.getElementById("box")).background;
      const ends = pictures().slice(part, part + 2);
      const [from, to] = two(sum, ends, ends.join());
      [from.style.opacity, to.style.opacity] = [1 - t, t];
      from.style.imageRendering = to.style.imageRendering = pixelated;
    }
    const before = state.previous?.contentWindow?.clmorph;
    if (state.previous) {
      state.previous.hidden = state.mode !== "previous";
      const corners = [outer.top, frame.clientWidth - outer.right, frame.clientHeight - outer.bottom, outer.left + (outer.width * state.at) / 100];
      state.previous.style.clipPath = `inset(${corners.map((each) => `${Math.max(0, each)}px`).join(" ")})`;
      if (before && state.mode === "previous" && Math.abs(before.time - time) > 1e-9 && state.sought !== time) {
        state.sought = time;
        before.pause();
        before.seek(time);
      }
    }
    names[0].textContent = "now";
    names[1].textContent = state.mode === "fade" ? "cross-fade" : state.label;
  }

  return {
    state,
    get modes() { return { fade: true, previous: Boolean(state.previous), masses: state.unmatched.length > 0 }; },
    /** Show nothing more ("none"), a cross-fade ("fade"), "previous" settings or the "masses". */
    choose(mode) {
      state.mode = mode;
      const runs = mode !== "none";
      layer.hidden = !runs;
      if (state.previous) state.previous.hidden = mode !== "previous";
      if (runs && !state.running) {
        state.running = true;
        requestAnimationFrame(follow);
      }
      state.running = runs;
    },
    /** Keep a viewer, which another one has replaced, as that of the settings before. */
    keep(frame, label) {
      state.previous?.remove();
      state.previous = frame;
      state.label = label;
      state.sought = null;
      frame.classList.add("previous");
      frame.setAttribute("aria-hidden", "true");
      frame.tabIndex = -1;
      frame.hidden = state.mode !== "previous";
    },
    /** What is destroyed and created in the film that is shown now. */
    film(number, unmatched) {
      [state.shown, state.unmatched] = [number, unmatched || []];
    },
    clear() {
      state.previous?.remove();
      Object.assign(state, { previous: null, label: "", unmatched: [] });
    },
  };
}
