// Paints distances by the scale that the wallet sends (clients/sdk/depth_colours.py): near is bright, far is dark; grey is
// what the camera did not measure.

import { h, replace, s } from "./shared/dom.js";
import { locale, t } from "./texts.js";

const LEVELS_COUNT = 256;
const TICK_MM = 1000;
const STEPS_COUNT = 100;

const mix = (from, to, share) => Math.round(from + (to - from) * share);
const channels = (hex) => [0, 2, 4].map((place) => parseInt(hex.slice(place, place + 2), 16));

/** The colour at a share of the way from near (0) to far (1), as [red, green, blue]. */
function colourAt(anchors, share) {
  const place = Math.min(Math.max(share, 0), 1) * (anchors.length - 1);
  const index = Math.min(Math.floor(place), anchors.length - 2);
  const [from, to] = [channels(anchors[index]), channels(anchors[index + 1])];
  return from.map((value, channel) => mix(value, to[channel], place - index));
}

/** Read the scale as it is sent: {near, far, at(share), table, grey}. */
export function readScale({ near_mm: near, far_mm: far, anchors, unmeasured }) {
  const at = (share) => colourAt(anchors, share);
  const table = Uint32Array.from({ length: LEVELS_COUNT }, (_, level) => pack(at(level / (LEVELS_COUNT - 1))));
  return { near, far, at, table, grey: [unmeasured, unmeasured, unmeasured] };
}

function pack([red, green, blue]) {
  return ((255 << 24) | (blue << 16) | (green << 8) | red) >>> 0;
}

/** Paint distances (Uint16Array, mm) into the pixels of an ImageData of the same size; say whether any of it is grey. */
export function paint(depth, image, { near, far, table, grey }) {
  const pixels = new Uint32Array(image.data.buffer);
  const [scale, unmeasured] = [(LEVELS_COUNT - 1) / (far - near), pack(grey)];
  let isGrey = false;
  for (let place = 0; place < depth.length; place += 1) {
    const mm = depth[place];
    isGrey ||= mm === 0;
    pixels[place] = mm === 0 ? unmeasured : table[Math.min(LEVELS_COUNT - 1, Math.max(0, Math.floor((mm - near) * scale)))];
  }
  return isGrey;
}

/** What grey stands for: what was not measured, and without the room all that is not the owner's. */
export const greyWords = (isAlone) => t(isAlone ? "legend.leftOut" : "legend.unmeasured");

/** A scale in metres as wide as there is room for, and what grey is: {node, show(isGrey, isAlone)}. */
export function legend({ near, far, at, grey: unmeasured }) {
  const [top, height] = [2, 12];
  const metres = (mm) => new Intl.NumberFormat(locale(), { maximumFractionDigits: 1 }).format(mm / 1000);
  const x = (mm) => (mm - near) / (far - near);
  const percent = (share) => `${(share * 100).toFixed(2)}%`;
  const hex = (colour) => `rgb(${colour.join(" ")})`;
  const scale = s("svg", { class: "colour-legend", width: "100%", height: 34, role: "img" },
    s("title", {}, t("legend.label", { near: metres(near), far: metres(far) })));
  for (let step = 0; step < STEPS_COUNT; step += 1) {
    scale.append(s("rect", { x: percent(step / STEPS_COUNT), y: top, width: percent(1.2 / STEPS_COUNT), height, fill: hex(at(step / (STEPS_COUNT - 1))) }));
  }
  for (let mm = Math.ceil(near / TICK_MM) * TICK_MM; mm <= far; mm += TICK_MM) {
    scale.append(s("line", { x1: percent(x(mm)), x2: percent(x(mm)), y1: top + height, y2: top + height + 3 }));
    scale.append(s("text", { x: percent(x(mm)), y: 30, "text-anchor": anchorAt(x(mm)) }, mm + TICK_MM > far ? `${metres(mm)} m` : metres(mm)));
  }
  const words = h("span", {}, greyWords(false));
  const swatch = s("svg", { width: 12, height: 12, "aria-hidden": "true" }, s("rect", { width: 12, height: 12, fill: hex(unmeasured) }));
  const grey = h("span", { class: "grey-legend" }, swatch, words);
  return {
    node: h("div", { class: "legend-row" }, scale, grey),
    show(isGrey, isAlone) {
      grey.classList.toggle("none", !isGrey);
      replace(words, greyWords(isAlone));
    },
  };
}

/** Where a number stands on its line: within the scale, also at its ends. */
const anchorAt = (share) => (share < 0.03 ? "start" : share > 0.97 ? "end" : "middle");
