// Curves over morph time, with a cursor; pressing or dragging moves the cursor.

const SVG = "http://www.w3.org/2000/svg";

function change(node, attributes) {
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  return node;
}

function element(name, attributes = {}, ...children) {
  const made = change(document.createElement(name), attributes);
  made.append(...children);
  return made;
}

const shape = (name, attributes) => change(document.createElementNS(SVG, name), attributes);

/**
 * @param {object[]} curves each with name, unit, values
 * @param {number[]} times
 * @param {HTMLElement} parent
 * @param {(time: number) => void} seek
 */
function makeCharts(curves, times, parent, seek) {
  const [first, last] = [times[0], times[times.length - 1]];
  const across = (time) => (last > first ? (1000 * (time - first)) / (last - first) : 500);
  const charts = [...new Set(curves.map((curve) => curve.unit))].map(chart);

  function chart(unit) {
    const group = curves.filter((curve) => curve.unit === unit);
    const values = group.flatMap((curve) => curve.values);
    const highest = Math.max(0, largest(values));
    const lowest = Math.min(0, smallest(values));
    const top = highest > 0 ? roundUp(highest) : lowest < 0 ? 0 : 1;
    const bottom = lowest < 0 ? -roundUp(-lowest) : 0;
    // As many decimals at any time, so that numbers do not dance.
    const decimals = 3 - Math.ceil(Math.log10(Math.max(top, -bottom)));
    const format = (value) => (decimals > 6 ? short(value) : value.toFixed(Math.max(0, decimals)));
    const up = (value) => 100 * (1 - (value - bottom) / (top - bottom));

    const svg = shape("svg", { viewBox: "0 0 1000 100", preserveAspectRatio: "none", "aria-hidden": "true" });
    for (const level of [0, 50, 100]) svg.append(shape("line", { class: "grid", x1: 0, x2: 1000, y1: level, y2: level }));
    for (let time = Math.ceil(first); time <= last; time += Math.ceil((last - first) / 12) || 1) {
      svg.append(shape("line", { class: "grid", x1: across(time), x2: across(time), y1: 0, y2: 100 }));
    }
    const cursor = shape("line", { class: "cursor", y1: 0, y2: 100 });
    svg.append(cursor);
    const legend = element("ul", { class: "legend" });
    const marks = group.map((curve, k) => {
      const points = curve.values.map((value, i) => `${across(times[i])},${up(value)}`).join(" ");
      svg.append(shape("polyline", { class: `curve curve-${k % 4}`, points }));
      // A line without length has round ends only: a dot that the stretched drawing leaves round.
      const dot = shape("line", { class: `dot curve-${k % 4}` });
      svg.append(dot);
      const output = element("output", {});
      const key = element("span", { class: `key curve-${k % 4}` });
      legend.append(element("li", {}, key, curve.name, output));
      return { curve, dot, output };
    });
    const plot = element("div", { class: "plot" }, svg);
    const label = (text, name) => element("span", { class: `label ${name}`, "aria-hidden": "true" }, text);
    plot.append(label(short(top), "top"), label(short(bottom), "bottom"));
    plot.append(label(`t = ${short(first)}`, "first"), label(short(last), "last"));
    const names = group.map((curve) => curve.name).join(", ");
    parent.append(element("figure", { class: "chart", role: "group", "aria-label": `${names}, in ${unit}, over time` },
      legend, element("p", { class: "unit" }, unit), plot));

    const pick = (event) => {
      const frame = svg.getBoundingClientRect();
      const share = Math.max(0, Math.min(1, (event.clientX - frame.left) / frame.width));
      seek(first + share * (last - first));
    };
    plot.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      plot.setPointerCapture(event.pointerId);
      pick(event);
    });
    plot.addEventListener("pointermove", (event) => {
      if (plot.hasPointerCapture(event.pointerId)) pick(event);
    });

    return (index) => {
      const x = across(times[index]);
      change(cursor, { x1: x, x2: x });
      for (const { curve, dot, output } of marks) {
        const y = up(curve.values[index]);
        change(dot, { x1: x, x2: x, y1: y, y2: y });
        output.textContent = format(curve.values[index]);
      }
    };
  }

  return { update: (index) => charts.forEach((update) => update(index)) };
}
