// The parts that the explorer's pages are made of: links, tables, facts with words, values of the chain, certificates.

import { h, s } from "./shared/dom.js";
import { formatDuration, formatNumber, formatTime, shortHex } from "./shared/format.js";
import { Bytes } from "./msgpack.js";
import { api } from "./api.js";

/** A link to a page of the explorer. */
export function go(place, ...children) {
  return h("a", { href: `#/${place}` }, ...children);
}

/** A page: its title, a sentence or two that say what one sees, and what one sees. */
export function sheet(title, words, ...children) {
  return [h("h1", { tabindex: "-1" }, title), h("p", { class: "lead" }, words), children];
}

export function card(title, ...children) {
  return h("section", { class: "card" }, title && h("h2", {}, title), ...children);
}

export function badge(text, tone = "") {
  return h("span", { class: `badge ${tone}` }, text);
}

/** A long name: its ends, all of it on hover and for copying. */
export function hex(text) {
  return h("span", { class: "mono", title: text }, shortHex(text));
}

/** A long name in full, with a button that copies it. */
export function fullHex(text) {
  const button = h("button", { type: "button", class: "plain copy", "aria-label": `Copy ${shortHex(text)}`, onclick: async () => {
    await navigator.clipboard?.writeText(text).catch(() => {});
    button.textContent = "copied";
    setTimeout(() => { button.textContent = "copy"; }, 1500);
  } }, "copy");
  return h("span", {}, h("span", { class: "mono" }, text), navigator.clipboard ? button : null);
}

/** A moment; what others wrote on the chain may be beyond all calendars, and stays a number. */
export function moment(ms) {
  if (!(Math.abs(Number(ms)) <= 8.64e15)) return h("span", { class: "mono" }, `${ms} ms`);
  return h("time", { datetime: new Date(ms).toISOString(), title: new Date(ms).toISOString() }, formatTime(ms));
}

/** How long ago, by the node's clock. */
export function ago(ms, nowMs) {
  return nowMs - ms < 1000 ? "just now" : `${formatDuration(Math.max(0, nowMs - ms))} ago`;
}

/** How wide a chart may be here: as wide as the page is, and no wider than it reads well. */
export function chartWidth() {
  return Math.max(280, Math.min(1040, document.documentElement.clientWidth - 96));
}

export function number(value) {
  return formatNumber(value);
}

/** Facts: [name, value, words that explain it]. */
export function facts(rows) {
  return h("dl", { class: "facts" }, rows.filter(Boolean).map(([name, value, words]) => [
    h("dt", {}, name), h("dd", {}, value, words && h("div", { class: "quiet" }, words)),
  ]));
}

/** A table. `heads`: a text, or [text, "number"]; rows of cells. A region that scrolls can be reached by keyboard. */
export function table(caption, heads, rows, empty = "There is nothing yet.") {
  if (!rows.length) return h("p", { class: "quiet" }, empty);
  const kinds = heads.map((head) => (Array.isArray(head) ? head[1] : ""));
  return h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption },
    h("table", { class: "list" }, h("caption", { class: "visually-hidden" }, caption),
      h("thead", {}, h("tr", {}, heads.map((head, index) => h("th", { scope: "col", class: kinds[index] }, Array.isArray(head) ? head[0] : head)))),
      h("tbody", {}, rows.map((cells) => row(cells, kinds)))));
}

export function row(cells, kinds = []) {
  return h("tr", {}, cells.map((cell, index) => h("td", { class: kinds[index] }, cell)));
}

/** A value of the chain as text that can be read; nothing of it is ever run or taken for markup. */
export function valueView(value, depth = 0) {
  if (value === null || value === undefined) return h("span", { class: "quiet" }, "none");
  if (value instanceof Bytes) return value.hex === "" ? h("span", { class: "quiet" }, "no bytes") : h("span", { class: "mono" }, value.hex.length > 132 ? `${value.hex.slice(0, 128)}… (${value.hex.length / 2} bytes)` : value.hex);
  if (typeof value === "string") return value === "" ? h("span", { class: "quiet" }, "empty text") : h("span", {}, value.length > 600 ? `${value.slice(0, 600)}… (${value.length} characters)` : value);
  if (value instanceof Map || (typeof value === "object" && !Array.isArray(value))) {
    const entries = value instanceof Map ? [...value] : Object.entries(value);
    if (!entries.length) return h("span", { class: "quiet" }, "nothing");
    if (depth > 5) return h("span", { class: "quiet" }, "…");
    return h("dl", { class: "facts value" }, entries.slice(0, 60).map(([name, item]) => [h("dt", { class: name instanceof Bytes ? "mono" : "" }, name instanceof Bytes ? shortHex(name.hex) : String(name)), h("dd", {}, valueView(item, depth + 1))]));
  }
  if (Array.isArray(value)) {
    if (!value.length) return h("span", { class: "quiet" }, "an empty list");
    const more = value.length > 40 ? h("li", { class: "quiet" }, `and ${value.length - 40} more`) : null;
    return h("ol", { class: "value" }, value.slice(0, 40).map((item) => h("li", {}, valueView(item, depth + 1))), more);
  }
  return String(value);
}

/** What went wrong, in the node's words, and what to do. */
export function problemView(problem) {
  return h("div", { class: "notice warn", role: "alert" }, h("p", {}, problem.detail || problem.message),
    problem.nextStep && h("p", {}, problem.nextStep), problem.code && h("p", { class: "quiet" }, problem.code));
}

/** The name of a seat, or what stands for it. */
export function seatName(epoch, index) {
  return epoch?.seats[index]?.name || `seat ${index}`;
}

export async function nameOfProducer(header) {
  if (header.height === 0) return "genesis";
  return seatName(await api.epoch(header.epoch).catch(() => null), header.producer);
}

/** Small marks, one for each seat: filled for who signed. */
export function seatMarks(epoch, voters) {
  const size = 14;
  const count = epoch?.seats.length ?? Math.max(0, ...voters) + 1;
  const names = voters.map((index) => seatName(epoch, index)).join(", ");
  return s("svg", { class: "seats", viewBox: `0 0 ${count * size} ${size}`, width: count * size, height: size, role: "img", "aria-label": voters.length ? `signed by ${names}` : "no votes" },
    Array.from({ length: count }, (_, index) => s("circle", { class: voters.includes(index) ? "voted" : "absent", cx: size * (index + 0.5), cy: size / 2, r: 5 })));
}

/** A certificate as a ring of seats around the block; lines lead from who signed. */
export function certificateDrawing(epoch, voters, { leader, led = "led", label, tone = "voted" }) {
  const count = epoch.seats.length;
  const [width, height] = [360, 240];
  const [cx, cy, radius] = [width / 2, height / 2, 78];
  const id = `ring-${label.replace(/[^a-z0-9]/gi, "")}`;
  const names = voters.map((index) => seatName(epoch, index)).join(", ");
  const absent = epoch.seats.filter((seat) => !voters.includes(seat.index)).map((seat) => seat.name || `seat ${seat.index}`);
  const ring = s("svg", { class: "ring", viewBox: `0 0 ${width} ${height}`, width, height, role: "img", "aria-labelledby": `${id}-t ${id}-d` },
    s("title", { id: `${id}-t` }, label),
    s("desc", { id: `${id}-d` }, `Signed by ${names || "nobody"}; not in it: ${absent.join(", ") || "nobody"}.`));
  const places = epoch.seats.map((seat) => {
    const angle = (2 * Math.PI * seat.index) / count - Math.PI / 2;
    return [cx + radius * Math.cos(angle), cy + radius * Math.sin(angle), Math.cos(angle), Math.sin(angle)];
  });
  for (const index of voters) {
    if (places[index]) ring.append(s("line", { class: `vote ${tone}`, x1: places[index][0], y1: places[index][1], x2: cx, y2: cy }));
  }
  ring.append(s("rect", { class: "core", x: cx - 26, y: cy - 18, width: 52, height: 36, rx: 6 }),
    s("text", { x: cx, y: cy + 5, "text-anchor": "middle", class: "core-text" }, `${voters.length}/${count}`));
  places.forEach(([x, y, dx, dy], index) => {
    const has = voters.includes(index);
    ring.append(s("circle", { class: `seat ${has ? tone : "absent"} ${index === leader ? "leader" : ""}`, cx: x, cy: y, r: count > 12 ? 8 : 12 }));
    const far = count > 12 ? 14 : 20;
    ring.append(s("text", { x: x + dx * far, y: y + dy * far + (dy > 0.5 ? 10 : dy < -0.5 ? -2 : 4), "text-anchor": dx > 0.3 ? "start" : dx < -0.3 ? "end" : "middle" }, seatName(epoch, index) + (index === leader ? ` (${led})` : "")));
  });
  return ring;
}
