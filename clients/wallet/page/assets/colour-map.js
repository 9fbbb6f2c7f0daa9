// Colours for distances: even steps to the eye, and legible to the colour-blind (the anchors are those of viridis, by
// Nathaniel J. Smith and Stefan van der Walt, CC0). Near is bright, far is dark; grey is what the camera did not measure.

import { s } from "./shared/dom.js";
import { locale, t } from "./texts.js";

const ANCHORS = ["fde725", "d2e21b", "a5db36", "7ad151", "54c568", "35b779", "22a884", "1f988b", "23888e", "2a788e", "31688e", "39568c", "414487", "463480", "482173", "471063", "440154"];
const UNMEASURED = [72, 72, 76];
const LEVELS_COUNT = 256;
const TICK_MM = 1000;

const mix = (from, to, share) => Math.round(from + (to - from) * share);
const channels = (hex) => [0, 2, 4].map((place) => parseInt(hex.slice(place, place + 2), 16));

/** The colour at a share of the way from near (0) to far (1), as [red, green, blue]. */
export function colourAt(share) {
  const place = Math.min(Math.max(share, 0), 1) * (ANCHORS.length - 1);
  const index = Math.min(Math.floor(place), ANCHORS.length - 2);
  const [from, to] = [channels(ANCHORS[index]), channels(ANCHORS[index + 1])];
  return from.map((value, channel) => mix(value, to[channel], place - index));
}

const TABLE = Uint32Array.from({ length: LEVELS_COUNT }, (_, level) => pack(colourAt(level / (LEVELS_COUNT - 1))));
const GREY = pack(UNMEASURED);

function pack([red, green, blue]) {
  return ((255 << 24) | (blue << 16) | (green << 8) | red) >>> 0;
}

/** Paint distances (Uint16Array, mm) into the pixels of an ImageData of the same size. */
export function paint(depth, image, [near, far]) {
  const pixels = new Uint32Array(image.data.buffer);
  const scale = (LEVELS_COUNT - 1) / (far - near);
  for (let place = 0; place < depth.length; place += 1) {
    const mm = depth[place];
    pixels[place] = mm === 0 ? GREY : TABLE[Math.min(LEVELS_COUNT - 1, Math.max(0, Math.round((mm - near) * scale)))];
  }
}

/** A legend in metres, as a picture with words for who does not see it. */
export function legend([near, far]) {
  const [left, width, top, height] = [4, 300, 2, 12];
  const metres = (mm) => new Intl.NumberFormat(locale(), { maximumFractionDigits: 1 }).format(mm / 1000);
  const x = (mm) => left + ((mm - near) / (far - near)) * width;
  const hex = (colour) => `rgb(${colour.join(" ")})`;
  const node = s("svg", { class: "colour-legend", viewBox: "0 0 440 34", width: 440, height: 34, role: "img" },
    s("title", {}, t("legend.label", { near: metres(near), far: metres(far) })));
  const steps = 100;
  for (let step = 0; step < steps; step += 1) {
    node.append(s("rect", { x: left + (step / steps) * width, y: top, width: width / steps + 0.6, height, fill: hex(colourAt(step / (steps - 1))) }));
  }
  for (let mm = Math.ceil(near / TICK_MM) * TICK_MM; mm <= far; mm += TICK_MM) {
    node.append(s("line", { x1: x(mm), x2: x(mm), y1: top + height, y2: top + height + 3 }));
    node.append(s("text", { x: x(mm), y: 30, "text-anchor": "middle" }, mm + TICK_MM > far ? `${metres(mm)} m` : metres(mm)));
  }
  node.append(s("rect", { x: left + width + 24, y: top, width: 12, height, fill: hex(UNMEASURED) }));
  node.append(s("text", { x: left + width + 42, y: 13 }, t("legend.unmeasured")));
  return node;
}
