// Examples in tabs: each is a file in `examples`, shown as it is. Run imports the JavaScript file,
// so what is shown is what runs. Only the address of the server is replaced in the shell and Python
// files.

import { server, showIn, show } from "./examples/here.js";

/** @type {Record<string, string>} */
const LANGUAGES = { sh: "curl", py: "Python", js: "JavaScript" };
const WRITTEN = "http://127.0.0.1:8080";
const KEPT = "mlswarp.docs.language";

/**
 * @template {keyof HTMLElementTagNameMap} Name
 * @param {Name} name
 * @param {object} [members]
 * @param {...Node} children
 */
const element = (name, members = {}, ...children) => {
  const made = Object.assign(document.createElement(name), members);
  made.append(...children);
  return made;
};

/** @type {(node: ParentNode) => NodeListOf<HTMLElement>} */
const tabsOf = (node) => node.querySelectorAll('[role="tab"]');

const kept = () => {
  try {
    return localStorage.getItem(KEPT);
  } catch {
    return null; // the browser stores nothing for this page
  }
};

/**
 * Selects a language in every example that has it.
 * @param {string} language
 */
function select(language) {
  for (const tab of tabsOf(document)) {
    /** @type {HTMLElement | null} */
    const example = tab.closest(".example");
    if (!example?.dataset.languages?.split(" ").includes(language)) continue;
    const isChosen = tab.dataset.language === language;
    tab.setAttribute("aria-selected", String(isChosen));
    tab.tabIndex = isChosen ? 0 : -1;
    const panel = document.getElementById(tab.getAttribute("aria-controls") ?? "");
    if (panel) panel.hidden = !isChosen;
  }
  try {
    localStorage.setItem(KEPT, language);
  } catch {
    // The choice holds for this visit.
  }
}

/** @param {KeyboardEvent} event */
function onKey(event) {
  const tabs = [...tabsOf(/** @type {Element} */ (event.currentTarget))];
  const at = tabs.findIndex((tab) => tab === document.activeElement);
  /** @type {Record<string, number>} */
  const places = { ArrowRight: at + 1, ArrowLeft: at - 1, Home: 0, End: tabs.length - 1 };
  const to = places[event.key];
  if (to === undefined || at < 0) return;
  event.preventDefault();
  const tab = tabs[(to + tabs.length) % tabs.length];
  keepInPlace(tab, () => select(tab.dataset.language ?? "sh"));
  tab.focus();
}

/**
 * Changes the page without moving what the user looks at: examples above may have another height.
 * @param {Element} anchor
 * @param {() => void} change
 */
function keepInPlace(anchor, change) {
  const before = anchor.getBoundingClientRect().top;
  change();
  scrollBy(0, anchor.getBoundingClientRect().top - before);
}

/**
 * @param {string} name
 * @param {HTMLButtonElement} button
 * @param {Element} results
 */
async function run(name, button, results) {
  button.disabled = true;
  results.replaceChildren();
  showIn(results);
  try {
    // Another address each time: a module runs once per address.
    await import(`./examples/${name}.js?run=${Date.now()}`);
  } catch (error) {
    await show({ error: error instanceof Error ? error.message : String(error) });
  }
  button.disabled = false;
}

/** @param {HTMLElement} example */
async function build(example) {
  const { name = "", languages = "" } = example.dataset;
  const list = element("div", { role: "tablist", onkeydown: onKey, ariaLabel: "Language" });
  const results = element("div", { className: "results", ariaLive: "polite" });
  const copy = element("button", { className: "copy", type: "button", textContent: "Copy" });
  const bar = element("div", { className: "bar" }, list, copy);
  example.append(bar);
  for (const language of languages.split(" ")) {
    const text = await (await fetch(`docs/examples/${name}.${language}`)).text();
    const tab = element("button", {
      id: `${name}-${language}-tab`,
      role: "tab",
      type: "button",
      textContent: LANGUAGES[language],
    });
    tab.dataset.language = language;
    tab.setAttribute("aria-controls", `${name}-${language}`);
    tab.onclick = () => keepInPlace(tab, () => select(language));
    list.append(tab);
    const panel = element("pre", {
      id: `${name}-${language}`,
      role: "tabpanel",
      tabIndex: 0,
      textContent: text.replaceAll(WRITTEN, server.replace(/\/$/, "")),
    });
    panel.setAttribute("aria-labelledby", tab.id);
    example.append(panel);
  }
  copy.onclick = async () => {
    await navigator.clipboard?.writeText(
      example.querySelector("pre:not([hidden])")?.textContent ?? "",
    );
    copy.textContent = "Copied";
    setTimeout(() => (copy.textContent = "Copy"), 1500);
  };
  const button = element("button", {
    className: "run",
    type: "button",
    textContent: "Run",
    title: "Runs the JavaScript",
  });
  button.setAttribute("aria-label", `Run the example "${name}"`);
  button.onclick = () => run(name, button, results);
  bar.append(button);
  example.append(results);
}

/** @type {NodeListOf<HTMLElement>} */
const examples = document.querySelectorAll(".example");
await Promise.all([...examples].map(build));
const chosen = kept();
// For examples that do not have the chosen language.
select("js");
select(chosen && chosen in LANGUAGES ? chosen : "sh");
document.body.dataset.state = "ready";
