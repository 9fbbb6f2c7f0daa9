// Consent: what the organisation tells first, then a yes or a no for each purpose and sensor. A no is as near as a yes.
// Must never offer a yes before the notice in force was on the screen, nor to what it does not name, nor let a yes pass for
// one by which something is kept when it is none without depth.

import { announce, focusOn, h, replace } from "./shared/dom.js";
import { follow, get, post } from "./api.js";
import { moment, problemCard, progressOf, purposeName, redraw, sensorName, sentences } from "./pieces.js";
import { locale, t } from "./texts.js";

/** By this one a robot tells people apart: without a yes to it, it keeps nothing of any other sensor. */
const DEPTH = "depth";

/** Show the notice and the switches. */
export async function showConsent(context) {
  let data = await get("consents", {}, context.signal);
  const node = h("div", {});
  const said = h("div", { role: "status" });
  let isWorking = false;

  const draw = () => replace(node, noticeCard(), said, h("p", { class: "lead" }, t("consent.lead")), context.overview.counts.records > 0 && h("p", { class: "earlier" }, t("consent.earlier", { count: context.overview.counts.records }), " ", h("a", { href: "#/" }, t("nav.recordings"))), isBesideDepth() && h("p", { class: "quiet", id: "needs-depth" }, t("consent.needsDepth")), switches(), takeBack(), receipts());

  const noticeCard = () => {
    const { notice } = data;
    if (notice.version === 0) return h("div", { class: "notice warn" }, h("p", {}, t("notice.none", { organisation: notice.organisation })));
    const isChanged = notice.changes.length > 0;
    return h("section", { class: `card${notice.must_show ? " must-read" : ""}`, "aria-labelledby": "notice" },
      h("h2", { id: "notice" }, t("notice.title", { organisation: notice.organisation })),
      h("p", { class: "quiet" }, t("notice.version", { version: notice.version, time: moment(notice.published_at_ms) })),
      isChanged && [h("h3", {}, t("notice.changes")), h("ul", { class: "changes" }, notice.changes.map((line) => h("li", { class: line.startsWith("+") ? "added" : "gone" }, line)))],
      h("details", { open: notice.must_show }, h("summary", {}, t("notice.words")), h("div", { class: "notice-words", tabindex: 0, role: "region", "aria-label": t("notice.words") }, notice.lines.map((line) => h("p", {}, line)))),
      notice.must_show && h("p", {}, h("button", { type: "button", class: "primary", "data-key": "read", onclick: read }, t("notice.read2")), " ", h("span", { class: "quiet" }, t("notice.readWhy"))));
  };

  const read = async () => {
    data.notice = await post("notice/shown", { version: data.notice.version });
    data.notice.must_show = false;
    draw();
    focusOn(node.querySelector(".choices button"));
  };

  const isBesideDepth = () => Object.keys(data.purposes).some((purpose) => sensorsOf(purpose).some((sensor) => sensor !== DEPTH));

  const switches = () => Object.entries(data.purposes).map(([purpose, sentence]) => {
    const sensors = sensorsOf(purpose);
    return h("section", { class: "card choices", "aria-labelledby": `purpose-${purpose}` },
      h("h2", { id: `purpose-${purpose}` }, purposeName(purpose, sentence)),
      groundOf(purpose),
      sensors.map((sensor) => choiceRow(purpose, sensor)));
  });

  const sensorsOf = (purpose) => Object.keys(data.sensors)
    .filter((sensor) => isAskable(purpose, sensor) || choiceOf(purpose, sensor) !== undefined)
    .sort((one, other) => Number(other === DEPTH) - Number(one === DEPTH));

  const isAskable = (purpose, sensor) => data.askable[purpose]?.includes(sensor) === true;

  const choiceOf = (purpose, sensor) => data.choices.find((one) => one.purpose === purpose && one.sensor === sensor);

  const groundOf = (purpose) => {
    if (data.askable[purpose] !== undefined) return null;
    const ground = data.grounds[purpose];
    const { organisation } = data.notice;
    return h("p", { class: "quiet" }, ground === undefined ? t("consent.unnamed", { organisation }) : t("consent.otherGround", { organisation, ground, why: t(`consent.ground.${ground.at(-2)}`) }));
  };

  const choiceRow = (purpose, sensor) => {
    const choice = choiceOf(purpose, sensor);
    const isYes = choice?.status === "given";
    const isNo = choice !== undefined && !isYes;
    const name = `${sensorName(sensor)}, ${purposeName(purpose)}`;
    return h("div", { class: "choice", role: "group", "aria-label": name, "aria-describedby": sensor === DEPTH ? null : "needs-depth" },
      h("div", { class: "choice-words" }, h("strong", {}, sensorName(sensor)), h("div", { class: `quiet ${choice?.holds_now ? "yes-words" : ""}` }, wordsOf(choice, data.height)),
        choice?.lacks_depth && h("div", { class: "without-depth" }, t("consent.withoutDepth")),
        data.askable[purpose] !== undefined && !isAskable(purpose, sensor) && h("div", { class: "quiet" }, t("consent.unnamedSensor", { organisation: data.notice.organisation }))),
      h("div", { class: "row yes-no" },
        isAskable(purpose, sensor) && h("button", { type: "button", "data-key": `yes-${purpose}-${sensor}`, class: isYes ? "chosen good" : "", "aria-pressed": String(isYes), "aria-label": t("consent.yesTo", { name }), disabled: data.notice.must_show || isWorking, onclick: () => say("give", [purpose], [sensor]) }, t("consent.yes")),
        h("button", { type: "button", "data-key": `no-${purpose}-${sensor}`, class: isNo ? "chosen" : "", "aria-pressed": String(isNo), "aria-label": t("consent.noTo", { name }), disabled: isWorking, onclick: () => say(isYes ? "withdraw" : "refuse", [purpose], [sensor]) }, t("consent.no"))));
  };

  const takeBack = () => data.choices.some((choice) => choice.status === "given") && h("section", { class: "card" }, h("h2", {}, t("consent.backTitle")), h("p", {}, t("consent.backText")),
    h("button", { type: "button", "data-key": "back", disabled: isWorking, onclick: () => say("withdraw", [], []) }, t("consent.back")));

  const say = async (what, purposes, sensors) => {
    const progress = progressOf(t("consent.working"));
    isWorking = true;
    redraw(node, draw);
    replace(said, progress.node);
    said.scrollIntoView({ block: "nearest" });
    const body = what === "give" ? { purposes, sensors, notice_version: data.notice.version } : { purposes, sensors };
    try {
      const { job } = await post(`consents/${what}`, body);
      const result = await follow(job, progress.show);
      data = await get("consents", {}, context.signal);
      const words = t("consent.holds", { height: result.from_height });
      replace(said, h("div", { class: "notice good" }, h("p", {}, h("strong", {}, t(`consent.said.${what}`)), " ", words), h("p", { class: "quiet" }, result.receipt ? t("consent.receiptIn") : t("consent.receiptLater"))));
      announce(`${t(`consent.said.${what}`)} ${words}`);
    } catch (error) {
      if (error.name === "AbortError") return;
      replace(said, problemCard(error));
      if (error.code === "NOTICE_NOT_SHOWN") data = await get("consents", {}, context.signal);
    } finally {
      isWorking = false;
      redraw(node, draw);
      focusOn(node.querySelector(`[data-key="${what === "give" ? "yes" : "no"}-${purposes[0]}-${sensors[0]}"]`));
    }
  };

  const receipts = () => {
    const body = h("div", {});
    const details = h("details", { class: "card", ontoggle: async () => {
      if (!details.open || body.hasChildNodes()) return;
      try {
        const found = await get("consents/receipts", {}, context.signal);
        replace(body, found.receipts.length === 0 ? h("p", { class: "quiet" }, t("consent.noReceipts")) : sentences(found.receipts.map(receiptWords)), found.missing > 0 && h("p", { class: "quiet" }, t("consent.missing", { count: found.missing })));
      } catch (error) {
        if (error.name !== "AbortError") replace(body, problemCard(error));
      }
    } }, h("summary", {}, t("consent.receipts")), body);
    return details;
  };

  draw();
  return { title: t("consent.title"), node };
}

/** Say in words what was said, of what, when, and who signed. */
function receiptWords(one) {
  const names = (codes, nameOf, all) => (codes.length === 0 ? all : new Intl.ListFormat(locale()).format(codes.map((code) => nameOf(code))));
  return h("span", {}, `${moment(one.time_ms)}: `, h("strong", {}, t(`consent.status.${one.status}`)), " ",
    t("consent.receiptOf", { purposes: names(one.purposes, purposeName, t("consent.allPurposes")), sensors: names(one.sensors, sensorName, t("consent.allSensors")) }), " ",
    h("span", { class: "quiet" }, t("consent.receiptSigned", { height: one.height, node: one.signed_by, organisation: one.organisation })));
}

/** Say in words what stands for one purpose and sensor. */
function wordsOf(choice, height) {
  if (choice === undefined) return t("consent.never");
  const since = choice.from_height > height ? t("consent.from", { height: choice.from_height }) : t("consent.since", { time: moment(choice.since_ms), height: choice.from_height });
  const until = choice.period_until_ms ? ` ${t("consent.until", { time: moment(choice.period_until_ms) })}` : "";
  const said = choice.mandate_id ? ` ${t("consent.mandated")}` : "";
  return `${t(`consent.status.${choice.status}`)} ${since}${until}${said}`;
}
