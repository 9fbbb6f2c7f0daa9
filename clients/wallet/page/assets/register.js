// Registering with the code on one's card. Must never offer it before the notice of who issued that very card was on the screen.

import { announce, focusOn, h, replace } from "./shared/dom.js";
import { follow, post, postWithPassphrase } from "./api.js";
import { moment, problemCard, progressOf } from "./pieces.js";
import { scanner } from "./scanning.js";
import { t } from "./texts.js";

/** The form: the code; then what one is told; then the passphrase. */
export async function showRegister(context) {
  const code = h("input", { id: "register-code", required: true, autocomplete: "off", autocapitalize: "characters", spellcheck: "false", placeholder: "BR1-…", "aria-describedby": "register-hint" });
  const result = h("div", {});
  const form = h("form", { class: "card", onsubmit: (event) => { event.preventDefault(); look(); } },
    h("p", {}, t("unregistered.text")),
    h("div", { class: "field" }, h("label", { for: "register-code" }, t("register.code")), code, h("p", { class: "quiet hint", id: "register-hint" }, t("register.codeHint"))),
    scanner((read) => { code.value = read; code.dispatchEvent(new Event("input")); look(); }, context.signal),
    h("button", { type: "submit", class: "primary" }, t("register.look")));

  let looks = 0;
  // What they were told is of the code that they looked up: with the first change of it that is gone.
  code.addEventListener("input", () => {
    looks += 1;
    replace(result);
  });

  const look = async (reason) => {
    looks += 1;
    const [mine, asked] = [looks, code.value];
    try {
      const { notice } = await post("registration/plan", { code: asked }, context.signal);
      if (mine !== looks) return;
      replace(result, reason, told(notice, asked));
      focusOn(result.querySelector("h2"));
    } catch (error) {
      if (error.name !== "AbortError" && mine === looks) replace(result, reason, problemCard(error));
    }
  };

  const told = (notice, asked) => h("section", { class: "card", "aria-labelledby": "register-told" },
    h("h2", { id: "register-told", tabindex: -1 }, notice.version === 0 ? t("notice.none", { organisation: notice.organisation }) : t("notice.title", { organisation: notice.organisation })),
    notice.version > 0 && [h("p", { class: "quiet" }, t("notice.version", { version: notice.version, time: moment(notice.published_at_ms) })),
      h("div", { class: "notice-words", tabindex: 0, role: "region", "aria-label": t("notice.words") }, notice.lines.map((line) => h("p", {}, line)))],
    h("p", {}, t("register.nothing")),
    h("p", {}, h("button", { type: "button", class: "primary", onclick: () => register(notice, asked) }, t("register.button"))));

  const register = async (notice, asked) => {
    const body = { code: asked, organisation: notice.organisation, notice_version: notice.version, notice_hash: notice.hash ?? "" };
    try {
      const accepted = await postWithPassphrase("registration", body, { title: t("register.askTitle"), text: t("register.askText", { organisation: notice.organisation }), confirm: t("register.button") });
      if (accepted === null) return;
      const progress = progressOf(t("register.working"));
      form.hidden = true;
      replace(result, progress.node);
      await follow(accepted.job, progress.show);
    } catch (error) {
      if (error.name === "AbortError") return;
      form.hidden = false;
      if (error.code === "NOTICE_NOT_SHOWN") await look(problemCard(error));
      else replace(result, problemCard(error));
      return;
    }
    await showDone();
  };

  /** Say that they are registered, also where what all views know cannot be read again at this moment. */
  const showDone = async () => {
    const trouble = await context.renew().then(() => null, (error) => problemCard(error, showDone));
    replace(result, h("section", { class: "card" }, h("p", {}, t("register.next")), h("p", {}, h("a", { class: "button primary", href: "#/consent" }, t("register.consent")))), trouble);
    context.retitle(t("register.done"));
    announce(t("register.done"));
  };

  return { title: t("unregistered.title"), node: h("div", {}, form, result), isRegistering: true, refresh() {} };
}
