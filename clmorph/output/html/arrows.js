// Arrows over the picture: where mass comes from, where it is now, where it goes.

/** The least displacement, in screen pixels, that has an arrow; shorter ones have a dot. */
const SHORTEST = 3;
/** The least distance of arrows, in screen pixels; closer ones are drawn as their mean. */
const APART = 18;

/**
 * @param {object[]} fields each with begin, end, positions, displacement, weights
 * @param {HTMLCanvasElement} canvas lies over the stage
 * @param {object} stage see makeStage
 */
function makeArrows(fields, canvas, stage) {
  const context = canvas.getContext("2d");
  const state = { visible: false };
  const thinned = new Map(); // field -> { side, arrows }

  function draw(time) {
    canvas.hidden = !state.visible;
    if (!state.visible) return;
    const ratio = devicePixelRatio;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.lineCap = "round";
    context.lineJoin = "round";
    for (const field of fields) {
      const share = (time - field.begin) / (field.end - field.begin);
      if (share < -1e-9 || share > 1 + 1e-9) continue;
      const arrows = thin(field, APART / stage.unit());
      const heaviest = largest(arrows.map((one) => one.mass));
      for (const { start, by, mass } of arrows) {
        const from = stage.place(...start);
        const to = stage.place(start[0] + by[0], start[1] + by[1]);
        arrow(from, to, share, heaviest > 0 ? mass / heaviest : 1);
      }
    }
  }

  /** Arrows at least about so far apart: means over squares of whole places. */
  function thin(field, apart) {
    const low = [0, 1].map((axis) => smallest(field.positions.map((start) => start[axis])));
    const wide = [0, 1].map((axis) => largest(field.positions.map((start) => start[axis])) - low[axis]);
    // The distance s of places, as if they filled a grid: (w / s + 1) (h / s + 1) = K.
    const most = Math.max(1, field.positions.length - 1);
    const sum = wide[0] + wide[1];
    const place = (sum + Math.sqrt(sum * sum + 4 * most * wide[0] * wide[1])) / (2 * most) || 1;
    const side = place * Math.max(1, Math.ceil(apart / place - 0.1));
    if (thinned.get(field)?.side === side) return thinned.get(field).arrows;
    const squares = new Map();
    field.positions.forEach((start, k) => {
      const key = start.map((value, axis) => Math.floor((value - low[axis]) / side + place / side / 2)).join();
      const mass = field.weights === null ? 1 : field.weights[k];
      const square = squares.get(key) || { start: [0, 0], by: [0, 0], mass: 0 };
      squares.set(key, square);
      square.mass += mass;
      for (const axis of [0, 1]) {
        square.start[axis] += mass * start[axis];
        square.by[axis] += mass * field.displacement[k][axis];
      }
    });
    const arrows = [...squares.values()].filter((square) => square.mass > 0);
    for (const square of arrows) {
      square.start = square.start.map((value) => value / square.mass);
      square.by = square.by.map((value) => value / square.mass);
    }
    thinned.set(field, { side, arrows });
    return arrows;
  }

  /** The whole way faintly, the part that is done plainly, a head where the mass is now. */
  function arrow(from, to, share, weight) {
    const [dx, dy] = [to[0] - from[0], to[1] - from[1]];
    const length = Math.hypot(dx, dy);
    const [x, y] = [from[0] + share * dx, from[1] + share * dy];
    // Directions that are told apart by hue; the dark casing keeps them legible on any picture.
    const hue = (Math.atan2(dy, dx) * 180) / Math.PI + 215;
    const strength = 0.35 + 0.65 * Math.sqrt(Math.min(1, weight));
    const color = (alpha) => `hsl(${hue} 95% 72% / ${alpha * strength})`;
    const casing = (alpha) => `rgb(0 0 0 / ${alpha * strength})`;
    if (length < SHORTEST) {
      dot(x, y, 2.2, casing(0.6));
      dot(x, y, 1.3, "rgb(255 255 255 / 0.8)");
      return;
    }
    line(from, to, 2.4, casing(0.22));
    line(from, to, 1, color(0.5));
    line(from, [x, y], 3.4, casing(0.5));
    line(from, [x, y], 1.7, color(1));
    const size = Math.max(3, Math.min(8, length / 2.5));
    const [ux, uy] = [dx / length, dy / length];
    context.beginPath();
    context.moveTo(x + ux * size * 0.7, y + uy * size * 0.7);
    context.lineTo(x - ux * size * 0.5 - uy * size * 0.5, y - uy * size * 0.5 + ux * size * 0.5);
    context.lineTo(x - ux * size * 0.5 + uy * size * 0.5, y - uy * size * 0.5 - ux * size * 0.5);
    context.closePath();
    context.lineWidth = 1.6;
    context.strokeStyle = casing(0.65);
    context.stroke();
    context.fillStyle = color(1);
    context.fill();
  }

  function line(from, to, width, style) {
    context.beginPath();
    context.moveTo(...from);
    context.lineTo(...to);
    context.lineWidth = width;
    context.strokeStyle = style;
    context.stroke();
  }

  function dot(x, y, radius, style) {
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    context.fillStyle = style;
    context.fill();
  }

  return { state, draw };
}
