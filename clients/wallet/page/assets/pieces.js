// Small pieces that several views are made of: problems, progress, badges, moments. Must never show what it does not know.

import { focusOn, h, replace } from "./shared/dom.js";
import { Problem } from "./shared/fetching.js";
import { formatClock, formatDay, formatTime, zoneName } from "./shared/format.js";
import { post } from "./api.js";
import { locale, said, t } from "./texts.js";

export const moment = (ms) => formatTime(ms, locale());
export const dayName = (ms) => formatDay(ms, locale());
export const clock = (ms) => formatClock(ms, locale());
export const zone = zoneName;

/** The day of a moment in the reader's zone, as 2026-11-22. */
export function dayOf(ms) {
  const date = new Date(ms);
  return `${date.getFullYear()}-${String(date.getMonth() + 1).padStart(2, "0")}-${String(date.getDate()).padStart(2, "0")}`;
}

/** The first moment of a day written as 2026-11-22, or of one so many days later. */
export function dateOf(day, later = 0) {
  const [year, month, date] = day.split("-").map(Number);
  return new Date(year, month - 1, date + later);
}

/** A purpose, a sensor or a reason in words; its code, or what the program says of it, where the catalogue has none. */
export const purposeName = (code, sentence) => said(`purpose.${code}`, sentence ?? code);
export const sensorName = (code) => said(`sensor.${code}`, code);
export const reasonName = (code, sentence) => said(`reason.${code}`, sentence ?? code);

/** What there is of each kind, as people say it: “12 depth pictures and 1 sound”. */
export function thingsOf(kinds) {
  const words = Object.entries(kinds).map(([kind, count]) => t(`content.${kind}`, { count }));
  return new Intl.ListFormat(locale()).format(words);
}

/** Show what came of something in its place, and go there: who works by keyboard or listens would be nowhere else. */
export function tell(place, card) {
  card.tabIndex = -1;
  replace(place, card);
  focusOn(card);
}

/** What went wrong, and the next step. `again` is what a button tries. */
export function problemCard(error, again) {
  const isProblem = error instanceof Problem || error.detail !== undefined;
  return h("div", { class: "notice bad", role: "alert" },
    h("p", {}, h("strong", {}, isProblem ? error.detail : t("problem.unexpected"))),
    (error.nextStep || error.next_step) && h("p", {}, error.nextStep || error.next_step),
    again && h("p", {}, h("button", { type: "button", onclick: again }, t("problem.again"))));
}

/** Progress of a job: call `show(job)` at each change. `node` is a polite live region. */
export function progressOf(label) {
  const bar = h("progress", { "aria-label": label });
  const words = h("p", {}, label);
  const stop = h("button", { type: "button", hidden: true }, t("job.stop"));
  const node = h("div", { class: "notice", role: "status" }, words, bar, h("p", { class: "row" }, stop));
  const show = (job) => {
    replace(words, job.state === "waiting" ? t("job.waiting") : stepWords(job) || label);
    if (job.of > 0) {
      bar.max = job.of;
      bar.value = job.done;
    } else bar.removeAttribute("value");
    stop.hidden = !(job.state === "waiting" || ["clip", "export"].includes(job.kind));
    stop.onclick = () => { post(`jobs/${job.job}/cancel`).catch(() => { stop.hidden = true; }); };
  };
  return { node, show };
}

/** What a job is doing, in the reader's language as far as the catalogue has it. */
function stepWords({ step, done, of }) {
  const words = step && said(`step.${step.replaceAll(" ", "_")}`, step);
  return words && of > 1 ? t("job.of", { step: words, done, of }) : words;
}

/** A badge for what is known of a recording's truth. */
export function verdictBadge(row) {
  if (row.kind === "notice") return null;
  if (row.verdict === "corrupted") return h("span", { class: "badge bad" }, t("verdict.corrupted"));
  if (row.verdict === "verified") return h("span", { class: "badge good" }, t("verdict.verified"));
  return h("span", { class: "badge" }, t("verdict.none"));
}

/** What a recording holds, in words. */
export function contentOf(row) {
  const left = row.frames - row.erased_frames.length;
  return t(`content.${["depth", "picture", "label", "sound", "notice"].includes(row.kind) ? row.kind : "depth"}`, { count: left });
}

/** A list of sentences. */
export const sentences = (lines, props = {}) => h("ul", { class: "sentences", ...props }, lines.map((line) => h("li", {}, line)));

/** Wait at a button while work goes on: it is busy and cannot be pressed twice. */
export async function busy(button, work) {
  button.disabled = true;
  button.setAttribute("aria-busy", "true");
  try {
    return await work();
  } finally {
    button.disabled = false;
    button.removeAttribute("aria-busy");
  }
}

/** Redraw `node` by `draw` and give the focus back to the element with the same data-key. */
export function redraw(node, draw) {
  const key = node.contains(document.activeElement) ? document.activeElement.closest("[data-key]")?.dataset.key : undefined;
  draw();
  if (key !== undefined) focusOn(node.querySelector(`[data-key="${CSS.escape(key)}"]`), { stay: true });
}
