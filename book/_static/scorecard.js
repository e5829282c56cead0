// Puts a filter in front of the tables of the scorecard. Without this script every row is shown.
document.addEventListener("DOMContentLoaded", () => {
  "use strict";
  const place = document.querySelector(".scorecard-filter");
  if (!place) return;
  const tables = [...document.querySelectorAll(".scorecard-scroll[data-paper]")];
  const rows = tables.flatMap((table) =>
    [...table.querySelectorAll("tbody tr")].map((row) => ({
      row,
      paper: table.dataset.paper,
      artefact: table.dataset.artefact,
      verdict: row.dataset.verdict,
      text: `${table.dataset.paper} ${table.dataset.artefact} ${row.textContent}`.toLowerCase(),
    })),
  );
  const VERDICTS = ["reproduced", "better", "differs", "weak", "printed again", "not comparable", "missing"];
  const values = (key, among) => [...new Set(among.map((entry) => entry[key]))];

  const add = (parent, tag, properties = {}) =>
    parent.appendChild(Object.assign(document.createElement(tag), properties));
  const form = add(place, "form", { className: "scorecard-form" });
  form.setAttribute("aria-label", "Filter the scorecard");
  const field = (name, tag, properties) => {
    const label = add(form, "label", { textContent: name });
    return add(label, tag, properties);
  };
  const paper = field("Paper", "select", { name: "paper" });
  const artefact = field("Artefact", "select", { name: "artefact" });
  const verdict = field("Verdict", "select", { name: "verdict" });
  const text = field("Text", "input", { name: "text", type: "search", autocomplete: "off" });
  add(form, "button", { type: "reset", textContent: "Show all" });
  const count = add(place, "p", { className: "scorecard-count" });
  count.setAttribute("role", "status");
  count.setAttribute("aria-live", "polite");

  const fill = (select, names) => {
    const chosen = select.value;
    select.replaceChildren(new Option("all", ""), ...names.map((name) => new Option(name, name)));
    select.value = names.includes(chosen) ? chosen : "";
  };

  const keep = () => {
    const query = new URLSearchParams();
    for (const control of [paper, artefact, verdict, text]) if (control.value) query.set(control.name, control.value);
    try {
      history.replaceState(null, "", `${location.pathname}${query.size ? `?${query}` : ""}${location.hash}`);
    } catch {
      // some browsers do not let a page from disk change its address
    }
  };

  const apply = () => {
    fill(artefact, values("artefact", rows.filter((entry) => !paper.value || entry.paper === paper.value)));
    const words = text.value.toLowerCase().split(/\s+/).filter(Boolean);
    const shown = rows.filter((entry) => {
      const show =
        (!paper.value || entry.paper === paper.value) &&
        (!artefact.value || entry.artefact === artefact.value) &&
        (!verdict.value || entry.verdict === verdict.value) &&
        words.every((word) => entry.text.includes(word));
      entry.row.hidden = !show;
      return show;
    });
    for (const table of tables) table.hidden = !table.querySelector("tbody tr:not([hidden])");
    const parts = VERDICTS.map((name) => [name, shown.filter((entry) => entry.verdict === name).length])
      .filter(([, number]) => number)
      .map(([name, number]) => `${number} ${name}`);
    count.textContent = `${shown.length} of ${rows.length} rows${parts.length ? `: ${parts.join(", ")}` : ""}.`;
  };

  fill(paper, values("paper", rows));
  fill(verdict, VERDICTS.filter((name) => rows.some((entry) => entry.verdict === name)));
  const query = new URLSearchParams(location.search);
  paper.value = query.get("paper") ?? "";
  if (paper.selectedIndex < 0) paper.value = "";
  apply();
  for (const control of [artefact, verdict]) {
    control.value = query.get(control.name) ?? "";
    if (control.selectedIndex < 0) control.value = "";
  }
  text.value = query.get("text") ?? "";
  apply();
  // a link to a row shows it, even where the filter hides it
  const open = () => {
    const row = rows.find((entry) => entry.row.id && `#${entry.row.id}` === location.hash)?.row;
    if (!row) return;
    if (row.hidden) {
      for (const control of [paper, artefact, verdict, text]) control.value = "";
      apply();
      keep();
    }
    row.scrollIntoView({ block: "center" });
  };
  open();
  window.addEventListener("hashchange", open);
  form.addEventListener("input", () => { apply(); keep(); });
  form.addEventListener("submit", (event) => event.preventDefault());
  // a form is emptied after its reset event
  form.addEventListener("reset", () => setTimeout(() => { apply(); keep(); }));
});
