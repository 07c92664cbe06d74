// The clock: which frame is due. It waits for frames that are not decoded, and skips none of them
// unless the screen is slower than the film.

/** The most seconds that count between two pictures of the screen, as after a pause of the tab. */
const LONGEST_STEP = 0.25;

/**
 * @param {object} frames see makeFrames
 * @param {{fps: number, hold: number, loop: string}} setting
 * @param {(index: number) => void} show draws a decoded frame
 * @param {() => void} changed called when playing, direction, speed or loop have changed
 * @param {(error: Error) => void} fail
 */
function makePlayer(frames, setting, show, changed, fail) {
  const last = frames.count - 1;
  const state = { index: 0, playing: false, direction: 1, speed: 1, loop: setting.loop };
  let spent = 0; // seconds for which the frame has been shown
  let before = 0; // when the screen was last drawn
  let asked = 0; // counts requests, so that a late frame does not overtake

  const rest = (index) => 1 / setting.fps + (index === 0 || index === last ? setting.hold : 0);

  /** The frame after this one and the direction from there on; null at the end. */
  function following(index, direction) {
    const next = index + direction;
    if (next >= 0 && next <= last) return [next, direction];
    if (last === 0 || state.loop === "once") return null;
    if (state.loop === "loop") return [direction > 0 ? 0 : last, direction];
    return [index - direction, -direction];
  }

  function prefetch() {
    const indices = [];
    let at = [state.index, state.direction];
    while (at && indices.length < Math.min(AHEAD, last)) {
      at = following(...at);
      if (at) indices.push(at[0]);
    }
    frames.prefetch(indices);
  }

  function display(index) {
    state.index = index;
    show(index);
    prefetch();
  }

  /** Show a frame as soon as it is decoded. */
  async function seek(index) {
    const target = Math.max(0, Math.min(last, Math.round(index)));
    asked += 1;
    const request = asked;
    spent = 0;
    await frames.load(target);
    if (request === asked) display(target);
  }

  function tick(now) {
    if (!state.playing) return;
    requestAnimationFrame(tick);
    spent += Math.min(LONGEST_STEP, Math.max(0, (now - before) / 1000)) * state.speed;
    before = now;
    let shown = state.index;
    while (spent >= rest(shown)) {
      const next = following(shown, state.direction);
      if (!next) {
        if (shown !== state.index) display(shown);
        pause();
        return;
      }
      if (!frames.get(next[0])) {
        frames.load(next[0]).catch((error) => { pause(); fail(error); });
        spent = rest(shown);
        break;
      }
      spent -= rest(shown);
      [shown, state.direction] = next;
    }
    if (shown !== state.index) {
      asked += 1;
      display(shown);
    }
  }

  function play() {
    if (state.playing || last === 0) return;
    const end = state.direction > 0 ? last : 0;
    if (state.loop === "once" && state.index === end) seek(last - end).catch(fail);
    state.playing = true;
    spent = 0;
    before = performance.now();
    requestAnimationFrame(tick);
    changed();
  }

  function pause() {
    if (!state.playing) return;
    state.playing = false;
    changed();
  }

  /** Change direction, speed or loop. */
  function set(name, value) {
    state[name] = value;
    prefetch();
    changed();
  }

  return { state, last, play, pause, seek, set };
}
