// Plays an open clip: distances in colours on the empty room, colour pictures, sounds and estimates, one after the other.
// Must never show a picture that failed a check: in its place stands what is wrong.

import { focusOn, h, replace } from "./shared/dom.js";
import { greyWords, legend, paint, readScale } from "./colour-map.js";
import { FrameWindow } from "./frames.js";
import { clock } from "./pieces.js";
import { locale, t } from "./texts.js";

const PAUSE_MIN_MS = 15;
const PAUSE_MAX_MS = 1_000;
const PAUSE_USUAL_MS = 100;
const SPEEDS = [0.25, 0.5, 1, 2, 4];
const SHOWN_KINDS = ["depth", "picture"];

/** Return {node, stop(), start(), focus(), place(), isPlaying()} for a clip (GET clips/ID); `onErase(frame)` is asked for one picture's erasure, `at` where it begins. */
export function makePlayer(clip, depthScale, { signal, onErase, at }) {
  const frames = inTime(clip.frames);
  const scale = readScale(depthScale);
  const stages = SHOWN_KINDS.filter((kind) => frames.some((frame) => kindOf(frame) === kind)).map((kind) => makeStage(kind, scale));
  const source = new FrameWindow(clip, frames, signal);
  let place = 0;
  let timer = null;
  let speed = 1;
  let turn = 0;

  const range = h("input", { type: "range", min: 0, max: Math.max(0, frames.length - 1), value: 0, "aria-label": t("player.position"), oninput: () => { pause(); show(Number(range.value)); } });
  const where = h("p", { class: "quiet where" });
  const play = h("button", { type: "button", class: "primary", onclick: () => (timer === null ? start() : pause()) }, t("player.play"));
  const label = h("p", { class: "label-stream", hidden: true });
  const sound = h("audio", { controls: true, hidden: true, "aria-label": t("player.sound") });
  const instead = h("p", { class: "notice", hidden: true });
  const strip = h("canvas", { class: "strip", width: Math.min(1200, Math.max(1, frames.length)), height: 6, "aria-hidden": "true" });
  const rate = h("select", { onchange: () => { speed = Number(rate.value); } }, SPEEDS.map((value) => h("option", { value }, t("player.times", { speed: new Intl.NumberFormat(locale()).format(value) }))));
  rate.value = "1";
  const alone = h("input", { type: "checkbox", onchange: () => { source.setOnlyOwner(alone.checked); show(place); } });
  const erase = onErase && h("button", { type: "button", class: "danger", onclick: () => { pause(); onErase(frames[place]); } }, t(stages.length > 0 ? "player.erase" : "player.eraseOther"));

  const step = (by) => { pause(); show(Math.min(frames.length - 1, Math.max(0, place + by))); };
  const node = h("section", { class: "card player", "aria-label": t("player.label"), onkeydown: keys },
    frames.length === 0 ? h("p", {}, t("player.nothing")) : [
      h("div", { class: "stages" }, stages.map((stage) => stage.node)), stages.length === 0 && h("p", { class: "quiet" }, t("player.noPictures")), instead, label, sound,
      h("div", { class: "scrub" }, range, strip), where,
      h("div", { class: "row controls" }, play, h("button", { type: "button", "aria-label": t("player.back"), onclick: () => step(-1) }, "‹"), h("button", { type: "button", "aria-label": t("player.on"), onclick: () => step(1) }, "›"),
        h("label", { class: "inline" }, t("player.speed"), " ", rate), frames.some((frame) => frame.kind === "depth" && frame.status === "ok") && h("label", { class: "switch" }, alone, t("player.alone")),
        frames.some((frame) => SHOWN_KINDS.includes(frame.kind) && frame.status === "ok") && h("button", { type: "button", class: "push", onclick: () => stages[0].save(frames[place]) }, t("player.save")), erase),
      h("p", { class: "quiet small" }, t("player.keys"))]);

  function keys(event) {
    if (event.target.matches("input, select, textarea, audio") || event.ctrlKey || event.metaKey || event.altKey) return;
    const act = { ArrowLeft: () => step(-1), ArrowRight: () => step(1), Home: () => step(-frames.length), End: () => step(frames.length), k: () => play.click() }[event.key];
    if (act) {
      event.preventDefault();
      act();
    }
  }

  function start() {
    if (place >= frames.length - 1) place = 0;
    replace(play, t("player.pause"));
    timer = 0;
    run();
  }

  async function run() {
    while (timer !== null) {
      const began = performance.now();
      await show(place);
      if (timer === null || place >= frames.length - 1) break;
      const gap = frames[place + 1].at_ms - frames[place].at_ms || PAUSE_USUAL_MS;
      const rest = Math.min(PAUSE_MAX_MS, gap) / speed - (performance.now() - began);
      await new Promise((done) => { timer = setTimeout(done, Math.max(PAUSE_MIN_MS, rest)); });
      if (timer !== null) place += 1;
    }
    pause();
  }

  function pause() {
    if (timer !== null) clearTimeout(timer);
    timer = null;
    replace(play, t("player.play"));
  }

  async function show(to) {
    place = to;
    const mine = (turn += 1);
    const frame = frames[to];
    if (!frame) return;
    const words = t(stages.length > 0 ? "player.where" : "player.whereOther", { number: to + 1, count: frames.length, time: frame.captured_at_ms ? clock(frame.captured_at_ms) : "–" });
    range.value = to;
    range.setAttribute("aria-valuetext", words);
    replace(where, words);
    if (erase) erase.disabled = !["ok", "corrupted"].includes(frame.status);
    let content;
    try {
      content = await source.at(to);
    } catch (error) {
      if (error.name !== "AbortError") pause();
      return;
    }
    if (mine !== turn || signal.aborted) return;
    const kind = kindOf(frame);
    const stage = stages.find((one) => one.kind === kind) ?? (kind === "notice" ? stages[0] : undefined);
    if (instead.dataset.kind === kind) instead.hidden = true;
    if (content.nothing && stage) stage.say(t(`frame.${content.nothing}`), content.nothing);
    else if (content.nothing) sayInstead(kind, content.nothing);
    else if (content.label) {
      label.hidden = false;
      replace(label, h("strong", {}, content.label.label), content.label.confidence !== undefined && ` · ${t("player.confidence", { share: new Intl.NumberFormat(locale(), { style: "percent" }).format(content.label.confidence) })}`);
    } else if (content.sound) playSound(content.sound);
    else stage?.draw(content, frame);
    node.dataset.place = to;
    node.dataset.held = source.size;
  }

  /** Say what stands in the place of something without a stage. What was shown or heard of its kind before goes. */
  function sayInstead(kind, status) {
    if (kind === "label") label.hidden = true;
    if (kind === "sound") {
      sound.pause();
      sound.hidden = true;
    }
    instead.dataset.kind = kind;
    instead.hidden = false;
    instead.classList.toggle("bad", status === "corrupted");
    replace(instead, t(`frame.${status}${status === "notice" ? "" : "Other"}`));
  }

  function playSound(blob) {
    sound.hidden = false;
    if (sound.src) URL.revokeObjectURL(sound.src);
    sound.src = URL.createObjectURL(blob);
    if (timer !== null) sound.play().catch(() => {});
  }

  drawStrip(strip, frames);
  const stop = () => {
    pause();
    source.clear();
    if (sound.src) URL.revokeObjectURL(sound.src);
  };
  signal.addEventListener("abort", stop, { once: true });
  if (frames.length > 0) show(at ?? Math.max(0, frames.findIndex((frame) => frame.status === "ok" && SHOWN_KINDS.includes(frame.kind))));
  return { node, stop, start, focus: () => focusOn(play, { stay: true }), place: () => place, isPlaying: () => timer !== null };
}

/** Frames in the order of time; one that could not be opened stands where its number puts it. */
function inTime(frames) {
  let last = 0;
  const placed = frames.map((frame) => ({ ...frame, at_ms: (last = frame.captured_at_ms ?? last) }));
  return placed.sort((one, other) => one.at_ms - other.at_ms || one.number - other.number);
}

/** Which stage a frame belongs to; one that cannot be shown goes where the others of its recording do. */
function kindOf(frame) {
  return frame.kind ?? frame.holds;
}

function makeStage(kind, scale) {
  const canvas = h("canvas", { class: "stage", width: 640, height: 480, role: "img", "aria-label": t(`stage.${kind}`) });
  const words = h("p", { class: "stage-words", hidden: true });
  const probe = h("p", { class: "probe quiet", "aria-hidden": "true" });
  let drawn = null;
  const colours = kind === "depth" ? legend(scale) : null;
  const node = h("figure", { class: "stage-frame" }, h("div", { class: "stage-box" }, canvas, words), h("figcaption", {}, colours ? [colours.node, probe] : t("stage.picture")));
  const surface = canvas.getContext("2d", { willReadFrequently: false });
  const size = (width, height) => {
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  };
  canvas.addEventListener("pointermove", (event) => {
    if (!drawn?.depth) return;
    const box = canvas.getBoundingClientRect();
    const x = Math.floor(((event.clientX - box.left) / box.width) * drawn.width);
    const y = Math.floor(((event.clientY - box.top) / box.height) * drawn.height);
    const mm = drawn.depth[y * drawn.width + x];
    replace(probe, mm ? t("stage.probe", { metres: (mm / 1000).toLocaleString(locale(), { minimumFractionDigits: 2, maximumFractionDigits: 2 }) }) : greyWords(drawn.isAlone));
  });
  return {
    kind, node,
    draw(content, frame) {
      words.hidden = true;
      node.classList.remove("bad", "gone");
      drawn = content;
      if (content.depth) {
        size(content.width, content.height);
        const image = surface.createImageData(content.width, content.height);
        colours.show(paint(content.depth, image, scale), content.isAlone);
        surface.putImageData(image, 0, 0);
        canvas.setAttribute("aria-label", tellDepth(content, frame));
      } else {
        size(content.bitmap.width, content.bitmap.height);
        surface.drawImage(content.bitmap, 0, 0);
      }
    },
    say(text, status) {
      drawn = null;
      surface.clearRect(0, 0, canvas.width, canvas.height);
      node.classList.toggle("bad", status === "corrupted");
      node.classList.toggle("gone", status !== "corrupted");
      words.hidden = false;
      replace(words, text);
      canvas.setAttribute("aria-label", text);
    },
    save(frame) {
      canvas.toBlob((blob) => {
        const link = h("a", { href: URL.createObjectURL(blob), download: `blockrobot-${frame.record_id.slice(0, 12)}-${frame.index + 1}.png` });
        link.click();
        setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
      });
    },
  };
}

/** Say where the owner is in the picture, and how far away: the median of their box's middle. */
function tellDepth({ depth, width }, frame) {
  if (!frame.own || frame.own[2] === 0) return t("stage.depth");
  const [x, y, boxWidth, boxHeight] = frame.own;
  const found = [];
  for (let row = Math.floor(y + boxHeight / 4); row < y + (boxHeight * 3) / 4; row += 3) for (let column = Math.floor(x + boxWidth * 0.4); column < x + boxWidth * 0.6; column += 2) if (depth[row * width + column]) found.push(depth[row * width + column]);
  if (found.length === 0) return t("stage.depth");
  found.sort((one, other) => one - other);
  const side = (x + boxWidth / 2) / width;
  return t("stage.you", { side: t(side < 0.36 ? "stage.left" : side > 0.64 ? "stage.right" : "stage.middle"), metres: (found[found.length >> 1] / 1000).toLocaleString(locale(), { maximumFractionDigits: 1 }) });
}

/** A strip under the scrubber: where pictures are changed, erased or withheld. */
function drawStrip(strip, frames) {
  const surface = strip.getContext("2d");
  const colours = { corrupted: "#c0392b", erased: "#9aa0a8", notice: "#c79a2b" };
  frames.forEach((frame, place) => {
    const colour = colours[frame.status];
    if (!colour) return;
    surface.fillStyle = colour;
    const width = strip.width / frames.length;
    surface.fillRect(place * width, 0, Math.max(2, width), strip.height);
  });
}
