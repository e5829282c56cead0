// Searches the words of all pages, which search_pages.js holds: pages opened from disk cannot read each other.
document.addEventListener("DOMContentLoaded", () => {
  "use strict";
  const place = document.getElementById("search-results");
  const asked = new URLSearchParams(location.search).get("q") ?? "";
  if (!place || !window.searchPages) return;
  const STOP = new Set(
    `a about all an and any are as at be been but by can could did do does each for from get give gives had has have how
    i if in into is it its like make may me mean means much must my need no not of on or our shall should so some such
    than that the their them then there these they this to use used using was we well were what when where which who why
    will with work working works would you your`.split(/\s+/),
  );
  const KINDS = ["Chapter", "Page", "Notebook", "Reference"];
  const SHOWN = 30;
  const EXCERPT = [80, 160]; // letters before and after the first word that is found

  const stem = (word) => {
    const lower = word.toLowerCase();
    const cut = lower.replace(/(ations?|ating|ated|ates?|ings?|ed|es|s|e)$/, "");
    return cut.length >= 3 ? cut : lower;
  };
  const split = (text) => [...text.matchAll(/[\p{L}\p{N}]+/gu)];
  // a name such as ParticleFilter is also its words
  const stems_of = (word) => {
    const inside = word.split(/(?<=\p{Ll})(?=\p{Lu})/u);
    return (inside.length > 1 ? [word, ...inside] : inside).map(stem);
  };
  const stems = (text) => new Set(split(text).flatMap(([word]) => stems_of(word)));
  const among = (found, term) => found.has(term) || (term.length > 2 && [...found].some((word) => word.startsWith(term)));

  const words = split(asked).map(([word]) => word.toLowerCase());
  const telling = words.filter((word) => !STOP.has(word));
  const terms = [...new Set((telling.length ? telling : words).map(stem))];

  const pages = searchPages.map(([uri, title, topics, kind, parts]) => {
    const reference = KINDS[kind] === "Reference";
    const said = parts.map(([anchor, heading, text]) => ({
      anchor, heading, text, headings: stems(heading), stems: stems(`${heading} ${text}`),
    }));
    return {
      uri, title, kind, parts: said,
      // the name of a module is no topic
      title_stems: stems(reference ? "" : `${title} ${topics}`),
      heading_stems: new Set([...(reference ? stems(title) : []), ...said.flatMap((part) => [...part.headings])]),
    };
  });
  const rarity = terms.map((term) => {
    const having = pages.filter((page) =>
      among(page.title_stems, term) || among(page.heading_stems, term) || page.parts.some((part) => among(part.stems, term)),
    );
    return Math.log(1 + pages.length / Math.max(1, having.length));
  });

  // title before headings before text; at equal rank chapters first, the reference last
  const ranks = (page) => {
    let [title, heading, text] = [0, 0, 0];
    terms.forEach((term, k) => {
      const often = page.parts.filter((part) => among(part.stems, term)).length;
      if (among(page.title_stems, term)) title += rarity[k];
      else if (among(page.heading_stems, term)) heading += rarity[k];
      text += rarity[k] * (often / (often + 1));
    });
    return [title, heading, -page.kind, text];
  };
  const found = pages
    .map((page) => ({ page, rank: ranks(page) }))
    .filter(({ rank: [title, heading, , text] }) => title + heading + text > 0)
    .sort((a, b) => {
      const k = a.rank.findIndex((value, at) => value !== b.rank[at]);
      return k < 0 ? 0 : b.rank[k] - a.rank[k];
    });

  const add = (parent, tag, properties = {}) =>
    parent.appendChild(Object.assign(document.createElement(tag), properties));
  const is_term = (word) => terms.some((term) => among(new Set(stems_of(word)), term));
  const excerpt = (parent, text) => {
    const matches = split(text).filter(([word]) => is_term(word));
    const middle = matches[0]?.index ?? 0;
    const from = middle > EXCERPT[0] ? text.lastIndexOf(" ", middle - EXCERPT[0]) + 1 : 0;
    const end = text.indexOf(" ", middle + EXCERPT[1]);
    const to = end < 0 ? text.length : end;
    const line = add(parent, "p", { className: "context" });
    let at = from;
    line.append(from ? "… " : "");
    for (const match of matches.filter(({ index }) => index >= from && index < to)) {
      line.append(text.slice(at, match.index));
      add(line, "mark", { textContent: match[0] });
      at = match.index + match[0].length;
    }
    line.append(text.slice(at, to) + (to < text.length ? " …" : ""));
  };
  const best_part = (page) => {
    const score = (part) => terms.reduce((sum, term, k) =>
      sum + rarity[k] * (2 * among(part.headings, term) + among(part.stems, term)), 0);
    return page.parts.reduce((best, part) => (score(part) > score(best) ? part : best));
  };

  document.querySelector(".bd-search-container form input").value = asked;
  const said = add(place, "p", { className: "search-summary" });
  said.setAttribute("role", "status");
  if (!terms.length) return;
  const shown = found.slice(0, SHOWN);
  const pages_found = `${found.length} page${found.length === 1 ? "" : "s"} found`;
  said.textContent = pages_found + (found.length > SHOWN ? `, the first ${SHOWN} are shown.` : ".");
  const list = add(place, "ol", { className: "search" });
  for (const { page } of shown) {
    const item = add(list, "li");
    const part = best_part(page);
    const heading = part.heading && part.heading !== page.title ? `${page.title}: ${part.heading}` : page.title;
    add(item, "a", { href: page.uri + (part.anchor ? `#${part.anchor}` : ""), textContent: heading });
    add(item, "span", { className: "search-kind", textContent: ` ${KINDS[page.kind]}` });
    if (part.text) excerpt(item, part.text);
  }
});
