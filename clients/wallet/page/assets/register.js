// Registering with the code on one's card. Must never offer it before the notice of who issued the card was on the screen.

import { announce, h, replace } from "./shared/dom.js";
import { follow, post, postWithPassphrase } from "./api.js";
import { moment, problemCard, progressOf } from "./pieces.js";
import { t } from "./texts.js";

/** The form: the code; then what one is told; then the passphrase. */
export async function showRegister(context) {
  const code = h("input", { id: "register-code", required: true, autocomplete: "off", autocapitalize: "characters", spellcheck: "false", placeholder: "BR1-…", "aria-describedby": "register-hint" });
  const result = h("div", {});
  const form = h("form", { class: "card", onsubmit: (event) => { event.preventDefault(); look(); } },
    h("p", {}, t("unregistered.text")),
    h("div", { class: "field" }, h("label", { for: "register-code" }, t("register.code")), code, h("p", { class: "quiet hint", id: "register-hint" }, t("register.codeHint"))),
    h("button", { type: "submit", class: "primary" }, t("register.look")));

  const look = async () => {
    try {
      const plan = await post("registration/plan", { code: code.value }, context.signal);
      replace(result, told(plan));
      result.querySelector("h2").focus();
    } catch (error) {
      if (error.name !== "AbortError") replace(result, problemCard(error));
    }
  };

  const told = ({ notice }) => h("section", { class: "card", "aria-labelledby": "register-told" },
    h("h2", { id: "register-told", tabindex: -1 }, notice.version === 0 ? t("notice.none", { organisation: notice.organisation }) : t("notice.title", { organisation: notice.organisation })),
    notice.version > 0 && [h("p", { class: "quiet" }, t("notice.version", { version: notice.version, time: moment(notice.published_at_ms) })),
      h("div", { class: "notice-words", tabindex: 0, role: "region", "aria-label": t("notice.words") }, notice.lines.map((line) => h("p", {}, line)))],
    h("p", {}, t("register.nothing")),
    h("p", {}, h("button", { type: "button", class: "primary", onclick: () => register(notice) }, t("register.button"))));

  const register = async (notice) => {
    try {
      const accepted = await postWithPassphrase("registration", { code: code.value, notice_version: notice.version }, { title: t("register.askTitle"), text: t("register.askText", { organisation: notice.organisation }), confirm: t("register.button") });
      if (accepted === null) return;
      const progress = progressOf(t("register.working"));
      form.hidden = true;
      replace(result, progress.node);
      await follow(accepted.job, progress.show);
      await context.renew();
      replace(result, h("section", { class: "card" }, h("h2", { tabindex: -1 }, t("register.done")), h("p", {}, t("register.next")), h("p", {}, h("a", { class: "button primary", href: "#/consent" }, t("register.consent")))));
      result.querySelector("h2").focus();
      announce(t("register.done"));
    } catch (error) {
      if (error.name === "AbortError") return;
      form.hidden = false;
      replace(result, problemCard(error));
      if (error.code === "NOTICE_NOT_SHOWN") await look();
    }
  };

  return { title: t("unregistered.title"), node: h("div", {}, form, result), isRegistering: true, refresh() {} };
}
