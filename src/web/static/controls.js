// On a static host: what needs a server is switched off, and says so. Not served by the program.

import { find } from "../dom.js";
import { BEHIND, NEEDS_SERVER, PROBLEMS } from "../words.js";
import { prepare as prepareEngine } from "./engine.js";

/** Controls of the page that need a server, by their ids. */
const CONTROLS = [
  ...["blend-open", "fit", "align", "annotations-save"],
  ...["copy-curl", "copy-link", "export-curl", "key-open"],
];

/**
 * Switches off a control, whatever the page makes of it later: a group that is disabled does.
 *
 * @param {Element} control
 */
function switchOff(control) {
  const shown = control.closest("label") ?? control;
  const group = document.createElement("fieldset");
  Object.assign(group, { className: "needs-server", disabled: true, title: NEEDS_SERVER.one });
  shown.replaceWith(group);
  group.append(shown);
}

/** @param {string} textContent */
const words = (textContent) =>
  Object.assign(document.createElement("p"), {
    className: "fine needs-server-words",
    textContent,
  });

export function prepare() {
  for (const id of CONTROLS) {
    const control = document.getElementById(id);
    if (control) switchOff(control);
  }
  for (const option of find("export-file").options) {
    option.disabled = option.value === "zip";
    if (option.disabled) option.text += ` (${NEEDS_SERVER.option})`;
  }
  find("limits").after(words(NEEDS_SERVER.start));
  find("panel").append(words(NEEDS_SERVER.all));
  find("download").title = "Full-size PNG";
  BEHIND.picture = NEEDS_SERVER.late;
  Object.assign(PROBLEMS, NEEDS_SERVER.problems);
  // How many pins choosing takes, and where the API is, helps nobody here.
  for (const idle of [find("fit-note"), ...document.querySelectorAll('p:has(> a[href="docs"])')])
    idle.setAttribute("hidden", "");
  document.body.dataset.service = "engine";
  return prepareEngine();
}
