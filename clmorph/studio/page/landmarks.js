// Pairs of landmarks on both pictures: set by clicks, moved by dragging or arrow keys.

/** Largest number of landmarks that show their numbers. */
const MOST_NUMBERED = 12;

/**
 * Landmarks on two pictures. Those that were found in them stand there first.
 *
 * changed() is called after each change of a complete pair.
 * found(pairs): show what was found, unless there are others.
 * attach(side, frame, picture): draw and edit them on a picture; side 0 is A, 1 is B.
 * pairs(): complete pairs, in pixels of the pictures as they were given.
 */
function makeLandmarks(changed) {
  let points = [];
  let known = []; // as they were found
  let sides = [];
  let active = true;

  const pairs = () => points.filter((pair) => pair[0] && pair[1]);
  const clamp = (value, most) => Math.min(Math.max(value, 0), most);

  function at(side, event) {
    const { frame, picture } = sides[side];
    const box = frame.querySelector("img").getBoundingClientRect();
    // The middle of the first pixel is 0.
    const x = ((event.clientX - box.left) / box.width) * picture.width - 0.5;
    const y = ((event.clientY - box.top) / box.height) * picture.height - 0.5;
    const round = (value, most) => Math.round(clamp(value, most - 1) * 10) / 10;
    return [round(x, picture.width), round(y, picture.height)];
  }

  function place(button, side, point) {
    const { picture } = sides[side];
    button.style.left = `${(100 * (point[0] + 0.5)) / picture.width}%`;
    button.style.top = `${(100 * (point[1] + 0.5)) / picture.height}%`;
    const number = Number(button.textContent);
    button.setAttribute("aria-label", `Landmark ${number} in ${"AB"[side]}, at ${point[0]}, ${point[1]}`);
  }

  function remove(index) {
    points.splice(index, 1);
    draw();
    changed();
  }

  function move(button, index, side, point) {
    points[index] = side ? [points[index][0], point] : [point, points[index][1]];
    place(button, side, point);
  }

  function draw(focus = null) {
    sides.forEach(({ frame }, side) => {
      for (const old of frame.querySelectorAll(".mark")) old.remove();
      points.forEach((pair, index) => {
        if (!pair[side]) return;
        const button = document.createElement("button");
        button.type = "button";
        button.className = points.length > MOST_NUMBERED ? "mark dot" : "mark";
        button.textContent = index + 1;
        place(button, side, pair[side]);
        button.addEventListener("pointerdown", (event) => {
          button.setPointerCapture(event.pointerId);
          event.stopPropagation();
        });
        button.addEventListener("pointermove", (event) => {
          if (button.hasPointerCapture(event.pointerId)) move(button, index, side, at(side, event));
        });
        button.addEventListener("pointerup", () => changed());
        button.addEventListener("click", (event) => event.stopPropagation());
        button.addEventListener("keydown", (event) => {
          const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
          if (event.key === "Delete" || event.key === "Backspace") remove(index);
          else if (step) {
            const { picture } = sides[side];
            const [x, y] = points[index][side];
            move(button, index, side, [clamp(x + step[0], picture.width - 1), clamp(y + step[1], picture.height - 1)]);
            changed();
          } else return;
          event.preventDefault();
        });
        frame.append(button);
        if (focus && focus[0] === index && focus[1] === side) button.focus();
      });
    });
  }

  function add(side, point) {
    let index = points.findIndex((pair) => !pair[side]);
    if (index < 0) index = points.push([null, null]) - 1;
    points[index] = side ? [points[index][0], point] : [point, points[index][1]];
    draw([index, side]);
    if (points[index][1 - side]) changed();
  }

  function attach(side, frame, picture) {
    sides[side] = { frame, picture };
    frame.tabIndex = 0;
    frame.setAttribute("role", "group");
    frame.setAttribute("aria-label", `Picture ${"AB"[side]}: Enter sets a landmark in its middle`);
    frame.addEventListener("click", (event) => { if (active) add(side, at(side, event)); });
    frame.addEventListener("keydown", (event) => {
      if (!active || event.key !== "Enter" || event.target !== frame) return;
      add(side, [Math.round(picture.width / 2), Math.round(picture.height / 2)]);
      event.preventDefault();
    });
  }

  return {
    pairs, attach, draw,
    detach() { sides = []; },
    /** Whether clicks set landmarks; those that are there stay visible as long as they do. */
    use(now) {
      active = now;
      for (const { frame } of sides) frame.classList.toggle("marking", now);
    },
    clear() { points = []; draw(); },
    forget() { points = known = []; draw(); },
    found(pairs) {
      const own = points.length > 0;
      known = pairs;
      if (!own) points = [...pairs];
      draw();
    },
    set(pairs) { points = [...pairs]; draw(); },
    back() { points = [...known]; draw(); },
    get any() { return points.length > 0; },
    /** Whether they are those that were found. */
    get untouched() { return JSON.stringify(pairs()) === JSON.stringify(known); },
    get known() { return known.length; },
  };
}
