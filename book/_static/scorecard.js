// The filter of the scorecard. Without this script every row is there, folded table by table.
document.addEventListener("DOMContentLoaded", () => {
  "use strict";
  const place = document.querySelector(".scorecard-filter");
  if (!place) return;
  const rows = [...document.querySelectorAll("table.cards tbody")].map((row) => {
    const { paper, artefact } = row.parentElement.dataset, { verdict, files } = row.dataset;
    const text = `${paper} ${artefact} ${row.textContent}`.toLowerCase();
    return { row, fold: row.closest("details"), paper, artefact, verdict, files, text };
  });
  const add = (parent, tag, properties) => parent.appendChild(Object.assign(document.createElement(tag), properties));
  const form = add(place, "form", { className: "scorecard-form", ariaLabel: "Filter of the scorecard" });
  const query = new URLSearchParams(location.search);
  const labels = { paper: "Paper", artefact: "Table, figure or section", verdict: "Verdict", files: "With the authors' files" };
  const choose = (key) => {
    const select = add(add(form, "label", { textContent: labels[key] }), "select", { name: key });
    const names = [...new Set(rows.map((one) => one[key]))].filter(Boolean);
    select.append(new Option("all", ""), ...names.map((name) => new Option(name, name)));
    select.value = names.includes(query.get(key)) ? query.get(key) : "";
    return select;
  };
  const selects = Object.keys(labels).filter((key) => rows.some((one) => one[key])).map(choose);
  const text = add(add(form, "label", { textContent: "Text" }), "input", { name: "text", type: "search", autocomplete: "off" });
  text.value = query.get("text") || "";
  add(form, "button", { type: "reset", textContent: "Clear" });
  const count = add(place, "p", { className: "scorecard-count", role: "status" });

  const apply = () => {
    const words = text.value.toLowerCase().split(/\s+/).filter(Boolean);
    for (const option of selects[1].options) { // of the chosen paper only
      option.hidden = !rows.some((one) => (!selects[0].value || one.paper === selects[0].value) && (!option.value || one.artefact === option.value));
    }
    if (selects[1].selectedOptions[0].hidden) selects[1].value = "";
    const filtered = words.length > 0 || selects.some((select) => select.value);
    for (const one of rows) {
      const chosen = selects.every(({ name, value }) => !value || one[name] === value);
      one.row.hidden = !(chosen && words.every((word) => one.text.includes(word)));
    }
    const shown = rows.filter((one) => !one.row.hidden);
    for (const fold of new Set(rows.map((one) => one.fold))) {
      fold.hidden = !shown.some((one) => one.fold === fold);
      fold.open = filtered;
    }
    count.textContent = `${shown.length} of ${rows.length} rows.`;
    const asked = new URLSearchParams([...new FormData(form)].filter(([, value]) => value));
    try {
      history.replaceState(null, "", `${location.pathname}${asked.size ? `?${asked}` : ""}${location.hash}`);
    } catch {
      // some browsers do not let a page from disk change its address
    }
  };
  // A link to a row shows it, even where the filter hides it.
  const follow = () => {
    const target = location.hash && document.getElementById(location.hash.slice(1));
    const found = rows.find(({ row }) => row === target);
    if (found) {
      if (found.row.hidden) form.reset();
      found.fold.open = true;
    }
    if (target) target.scrollIntoView({ block: found ? "center" : "start" });
  };
  form.addEventListener("input", apply);
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("reset", () => {
    for (const select of selects) select.value = "";
    text.value = "";
    apply();
  });
  apply();
  follow();
  window.addEventListener("hashchange", follow);
  window.addEventListener("load", follow);
});
