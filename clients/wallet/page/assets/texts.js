// The page's words, in the reader's language. They come from the wallet's one catalogue; nothing is worded in the code.

import { fetchJson, tellUnreachable } from "./shared/fetching.js";

const LOCALES = { en: "en-GB", pt: "pt-PT" };
let texts = {};
let current = "en";
let known = ["en"];

/** Fetch the words; without `wanted` in the language in which the wallet was started. */
export async function loadTexts(wanted) {
  const answer = await fetchJson(`./api/texts${wanted ? `?language=${encodeURIComponent(wanted)}` : ""}`);
  texts = answer.texts;
  current = answer.language;
  known = answer.languages;
  document.documentElement.lang = current;
  tellUnreachable({ detail: t("problem.unreachable"), nextStep: t("problem.unreachableNext") });
}

/** The language in use, and all there are. */
export const language = () => current;
export const languages = () => known;
/** The locale for dates and numbers. */
export const locale = () => LOCALES[current] ?? current;

/** Return a text with its {names} put in; plural forms are chosen by `count`. */
export function t(key, values = {}) {
  let text = texts[key];
  if (text === undefined) return key;
  if (typeof text !== "string") text = values.count === 1 ? text.one : text.other;
  return text.replace(/\{(\w+)\}/g, (whole, name) => {
    const value = values[name];
    if (value === undefined) return whole;
    return typeof value === "number" ? new Intl.NumberFormat(locale()).format(value) : value;
  });
}

/** Return a text if the catalogue has it, and what the wallet's program said otherwise. */
export function said(key, fallback, values = {}) {
  return texts[key] === undefined ? fallback : t(key, values);
}
