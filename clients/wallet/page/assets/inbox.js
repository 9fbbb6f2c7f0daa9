// Messages: what is wrong, who looked, what was shared with this person. Must never hide an alarm below good news.

import { h, replace } from "./shared/dom.js";
import { get } from "./api.js";
import { moment, purposeName, redraw, sentences } from "./pieces.js";
import { receiptList } from "./erasing.js";
import { t } from "./texts.js";

/** Show the messages, alarms first. */
export async function showInbox(context) {
  let data = await get("inbox", {}, context.signal);
  const node = h("div", {});
  const draw = () => {
    const isQuiet = data.alarms.length + data.looks.length + data.received.length + data.unread.length + data.overdue.length === 0;
    replace(node,
      isQuiet && h("div", { class: "card" }, h("p", {}, t("inbox.empty"))),
      data.alarms.map((alarm) => h("div", { class: "notice bad" }, h("h2", {}, t("inbox.alarm")), sentences([alarm.missing_records > 0 && t("visit.missing", { count: alarm.missing_records }), alarm.unreadable_records.length > 0 && t("visit.unreadable", { count: alarm.unreadable_records.length }), alarm.corrupted_records.length > 0 && t("inbox.corrupted", { count: alarm.corrupted_records.length })].filter(Boolean)), h("p", {}, h("a", { href: `#/visit/${alarm.visit}` }, t("inbox.visit"))))),
      data.overdue.map((erasure) => h("div", { class: "notice warn" }, h("h2", {}, t("inbox.overdue")), receiptList(erasure.custodians))),
      data.looks.length > 0 && h("section", { class: "card" }, h("h2", {}, t("inbox.looks")), sentences(data.looks.map((look) => t("inbox.look", { time: moment(look.time_ms), who: look.who, count: look.records })))),
      data.received.length > 0 && h("section", { class: "card" }, h("h2", {}, t("inbox.received")), data.received.map((one) => h("div", { class: "received" },
        h("p", {}, t("inbox.receivedOne", { count: one.records.length, purpose: purposeName(one.purpose), time: moment(one.shared_at_ms), until: moment(one.until_ms) })), sentences(one.lines))), h("p", { class: "quiet" }, t("inbox.receivedNext"))),
      data.unread.length > 0 && h("div", { class: "notice warn" }, sentences(data.unread.map((one) => one.line))),
      !data.reads_new && h("p", { class: "quiet" }, t("inbox.notNew")));
  };
  draw();
  return { title: t("inbox.title"), node, async refresh() {
    data = await get("inbox", {}, context.signal);
    redraw(node, draw);
  } };
}
