// Filter and order of the scorecard, and names for the dots of its picture. Without this script every row is there.
document.addEventListener("DOMContentLoaded", () => {
  "use strict";
  const place = document.querySelector(".scorecard-filter");
  if (!place) return;
  const VERDICTS = ["reproduced", "better", "differs", "weak", "printed again", "not comparable", "missing"];
  const ORDERS = {
    "": ["as in the papers"],
    low: ["regenerated / published, lowest first", (a, b) => a.ratio - b.ratio],
    high: ["regenerated / published, highest first", (a, b) => b.ratio - a.ratio],
    verdict: ["by verdict", (a, b) => VERDICTS.indexOf(a.verdict) - VERDICTS.indexOf(b.verdict)],
    band: ["farthest outside of its band first", (a, b) => b.away - a.away],
  };
  const NEEDS = { low: "ratio", high: "ratio", band: "away" };
  const tables = [...document.querySelectorAll("table.cards[data-paper]")];
  const fold = (table) => table.closest("details");
  const number = (text) => (text ? Number(text) : NaN);
  const rows = tables.flatMap((table) =>
    [...table.querySelectorAll("tbody")].map((row) => ({
      row,
      table,
      paper: table.dataset.paper,
      artefact: table.dataset.artefact,
      verdict: row.dataset.verdict,
      ratio: number(row.dataset.ratio),
      away: number(row.dataset.away),
      text: `${table.dataset.paper} ${table.dataset.artefact} ${row.textContent}`.toLowerCase(),
    })),
  );
  const values = (key, among) => [...new Set(among.map((entry) => entry[key]))];

  const add = (parent, tag, properties = {}) =>
    parent.appendChild(Object.assign(document.createElement(tag), properties));
  const form = add(place, "form", { className: "scorecard-form" });
  form.setAttribute("aria-label", "Filter and order of the scorecard");
  const field = (name, tag, properties) => {
    const label = add(form, "label", { textContent: name });
    return add(label, tag, properties);
  };
  const paper = field("Paper", "select", { name: "paper" });
  const artefact = field("Artefact", "select", { name: "artefact" });
  const verdict = field("Verdict", "select", { name: "verdict" });
  const text = field("Text", "input", { name: "text", type: "search", autocomplete: "off" });
  const order = field("Order", "select", { name: "order" });
  order.replaceChildren(...Object.entries(ORDERS).map(([key, [name]]) => new Option(name, key)));
  add(form, "button", { type: "reset", textContent: "Clear" });
  const controls = [paper, artefact, verdict, text, order];
  const count = add(place, "p", { className: "scorecard-count" });
  count.setAttribute("role", "status");
  count.setAttribute("aria-live", "polite");

  // Rows of all papers in one order need one table; a row then says where it is from.
  const ordered = tables[0].cloneNode(false);
  for (const key of ["paper", "artefact"]) delete ordered.dataset[key];
  ordered.classList.add("ordered");
  const caption = add(ordered, "caption");
  ordered.append(tables[0].tHead.cloneNode(true));
  ordered.hidden = true;
  fold(tables[0]).before(ordered);
  for (const { row, table } of rows) {
    const from = add(row.querySelector("th"), "span", { className: "from" });
    from.textContent = `${table.dataset.paper}, ${table.dataset.artefact}`;
  }

  const fill = (select, names) => {
    const chosen = select.value;
    select.replaceChildren(new Option("all", ""), ...names.map((name) => new Option(name, name)));
    select.value = names.includes(chosen) ? chosen : "";
  };

  const keep = () => {
    const query = new URLSearchParams();
    for (const control of controls) if (control.value) query.set(control.name, control.value);
    try {
      history.replaceState(null, "", `${location.pathname}${query.size ? `?${query}` : ""}${location.hash}`);
    } catch {
      // some browsers do not let a page from disk change its address
    }
  };

  const arrange = () => {
    const [name, compare] = ORDERS[order.value];
    const needs = NEEDS[order.value];
    const without = (entry) => Number(Boolean(needs) && Number.isNaN(entry[needs]));
    // what has no such number comes last
    const sorted = compare ? [...rows].sort((a, b) => without(a) - without(b) || (without(a) ? 0 : compare(a, b))) : rows;
    for (const entry of sorted) (compare ? ordered : entry.table).append(entry.row);
    caption.textContent = `All papers: ${name}`;
    ordered.hidden = !compare;
  };

  const apply = () => {
    fill(artefact, values("artefact", rows.filter((entry) => !paper.value || entry.paper === paper.value)));
    const asked = text.value.toLowerCase().split(/\s+/).filter(Boolean);
    const shown = rows.filter((entry) => {
      const show =
        (!paper.value || entry.paper === paper.value) &&
        (!artefact.value || entry.artefact === artefact.value) &&
        (!verdict.value || entry.verdict === verdict.value) &&
        asked.every((word) => entry.text.includes(word));
      entry.row.hidden = !show;
      return show;
    });
    const filtered = Boolean(paper.value || artefact.value || verdict.value || asked.length);
    for (const table of tables) {
      const whole = fold(table);
      const all = rows.filter((entry) => entry.table === table).length;
      const some = shown.filter((entry) => entry.table === table).length;
      whole.hidden = !some || Boolean(order.value);
      whole.open = filtered;
      // it speaks of the whole table only where the whole table is shown
      whole.querySelector(".whole").hidden = some < all;
      const part = whole.querySelector(".part") ?? add(whole.querySelector(".title"), "span", { className: "part" });
      part.textContent = some < all ? `: ${some} of its ${all} numbers.` : "";
    }
    const parts = VERDICTS.map((name) => [name, shown.filter((entry) => entry.verdict === name).length])
      .filter(([, total]) => total)
      .map(([name, total]) => `${total} ${name === "differs" && total > 1 ? "differ" : name}`);
    count.textContent = `${shown.length} of ${rows.length} rows${parts.length ? `: ${parts.join(", ")}` : ""}.`;
  };
  const update = () => {
    arrange();
    apply();
  };

  fill(paper, values("paper", rows));
  fill(verdict, VERDICTS.filter((name) => rows.some((entry) => entry.verdict === name)));
  const query = new URLSearchParams(location.search);
  const choose = (control) => {
    control.value = query.get(control.name) ?? "";
    if (control.selectedIndex < 0) control.selectedIndex = 0;
  };
  choose(paper);
  apply();
  for (const control of [artefact, verdict, text, order]) choose(control);
  update();

  // a link to a row shows it, even where the filter hides it
  const open = () => {
    const found = rows.find((entry) => `#${entry.row.id}` === location.hash);
    for (const entry of rows) entry.row.classList.toggle("opened", entry === found);
    if (!found) return;
    if (found.row.hidden) {
      for (const control of controls) control.selectedIndex === undefined ? (control.value = "") : (control.selectedIndex = 0);
      update();
      keep();
    }
    fold(found.table).open = true;
    found.row.scrollIntoView({ block: "center" });
  };
  open();
  window.addEventListener("hashchange", open);
  form.addEventListener("input", (event) => {
    if (event.target === order) arrange();
    apply();
    keep();
  });
  form.addEventListener("submit", (event) => event.preventDefault());
  // a form is emptied after its reset event
  form.addEventListener("reset", () => setTimeout(() => { update(); keep(); }));

  // The dots: one stop of the keyboard, arrows go from dot to dot; what a dot is stands below the picture.
  const dots = [...document.querySelectorAll(".scorecard-picture a")];
  const name = document.querySelector(".scorecard-dot");
  // in the letters of its row, which a title cannot show
  const show = (dot) => {
    const { row } = rows.find((entry) => `#${entry.row.id}` === dot.getAttribute("href"));
    const of = (element) => [...element.cloneNode(true).childNodes].filter((node) => node.className !== "from");
    const [title, published, regenerated, , said] = row.rows[0].cells;
    name.replaceChildren(row.querySelector(".from").textContent, ", ", ...of(title), ": published ", ...of(published),
      ", regenerated ", ...of(regenerated), ", ", said.textContent, ".");
  };
  dots.forEach((dot, k) => {
    dot.addEventListener("pointerenter", () => show(dot));
    dot.addEventListener("focus", () => show(dot));
    dot.addEventListener("click", () => setTimeout(open)); // the address may be the same as before
    dot.addEventListener("keydown", (event) => {
      const next = { ArrowRight: k + 1, ArrowLeft: k - 1, Home: 0, End: dots.length - 1 }[event.key];
      if (next === undefined || !dots[next]) return;
      event.preventDefault();
      dot.setAttribute("tabindex", "-1");
      dots[next].setAttribute("tabindex", "0");
      dots[next].focus();
    });
  });
});
