"use strict";
// Finds, sorts, draws and compares the runs of a page; all of them are in it, nothing is loaded.
(() => {
  const { runs, metrics } = JSON.parse(document.getElementById("hilbench-data").textContent);
  const { colour, missing, minus, axis, height } = window.axes;
  const names = Object.keys(metrics).sort();
  const place = (id) => document.getElementById(id);
  const made = (tag, text, kind) => {
    const element = document.createElement(tag);
    if (text !== undefined) element.textContent = text;
    if (kind) element.className = kind;
    return element;
  };
  const number = (value) => (missing(value) ? "\u2013" : minus(String(Number(value.toPrecision(5)))));
  const PASSED = "passed", ROWS = 200;
  const state = { sort: "began_s", down: true, rows: ROWS, chosen: new Set() };
  const text = runs.map((run) => [run.path, run.bench, run.began, run.set, run.fault, ...run.tags, ...run.notes].join(" ").toLowerCase());

  const option = (list, value) => list.append(Object.assign(made("option", value), { value }));
  for (const value of [...new Set(runs.map((run) => run.result))].sort()) option(place("result"), value);
  for (const name of names) option(place("metric"), name);

  const metric = () => place("metric").value;
  const valueOf = (at, key) => (key in metrics ? metrics[key][at] : runs[at][key]);
  const found = () => {
    const words = place("words").value.toLowerCase().split(/\s+/).filter(Boolean), result = place("result").value;
    const bound = (id) => (place(id).value === "" ? null : Number(place(id).value)), least = bound("least"), most = bound("most");
    const values = metrics[metric()] || [], sign = state.down ? -1 : 1;
    const rows = [];
    for (let at = 0; at < runs.length; at += 1) {
      if (result && runs[at].result !== result) continue;
      if ((least !== null || most !== null) && (values[at] === null || values[at] === undefined)) continue;
      if ((least !== null && values[at] < least) || (most !== null && values[at] > most)) continue;
      if (words.every((word) => text[at].includes(word))) rows.push(at);
    }
    const blank = (value) => missing(value) || value === "";
    return rows.sort((a, b) => {
      const x = valueOf(a, state.sort), y = valueOf(b, state.sort);
      if (blank(x) || blank(y)) return blank(x) - blank(y);
      return sign * (x < y ? -1 : x > y ? 1 : 0) || a - b;
    });
  };

  const columns = () => [
    ["path", "Run"], ["began_s", "Began"], ["result", "Result"], ["met", "Criteria", "number"],
    ["duration_s", "Lasted, s", "number"], ...(metric() ? [[metric(), metric(), "number"]] : []), ["set", "Set"],
  ];
  const cellOf = (at, key) => {
    const run = runs[at];
    if (key === "path") {
      const cell = made("td");
      if (run.link) cell.append(Object.assign(made("a", run.path), { href: run.link }));
      else cell.append(made("span", run.path));
      if (run.replay) cell.append(" ", Object.assign(made("a", "play again", "tag"), { href: run.replay }));
      for (const tag of run.tags) cell.append(" ", made("span", tag, "tag"));
      for (const note of [run.fault, ...run.notes].filter(Boolean)) cell.append(made("span", note, "reason"));
      return cell;
    }
    if (key === "began_s") return made("td", run.began);
    if (key === "result") return made("td", run.result, `result ${["passed", "completed"].includes(run.result) ? run.result : "failed"}`);
    if (key === "met") return made("td", run.criteria ? `${run.met}/${run.criteria}` : "", "number");
    if (key === "set") return made("td", run.set, "long note");
    return made("td", number(valueOf(at, key)), "number");
  };

  const table = (rows) => {
    const whole = made("table"), head = made("tr"), body = made("tbody");
    head.append(made("th", ""));
    for (const [key, title, kind] of columns()) {
      const cell = made("th", undefined, kind), button = made("button", title + (key === state.sort ? (state.down ? " \u25be" : " \u25b4") : ""), "sort");
      button.type = "button";
      button.addEventListener("click", () => {
        state.down = key === state.sort ? !state.down : key !== "path";
        state.sort = key;
        show();
      });
      cell.append(button);
      head.append(cell);
    }
    for (const at of rows.slice(0, state.rows)) {
      const row = made("tr"), cell = made("td"), box = made("input");
      box.type = "checkbox";
      box.checked = state.chosen.has(at);
      box.setAttribute("aria-label", `compare ${runs[at].path}`);
      box.addEventListener("change", () => {
        if (box.checked) state.chosen.add(at);
        else state.chosen.delete(at);
        compare();
      });
      cell.append(box);
      row.append(cell, ...columns().map(([key]) => cellOf(at, key)));
      body.append(row);
    }
    const top = made("thead");
    top.append(head);
    whole.append(top, body);
    return whole;
  };

  const compare = () => {
    const chosen = [...state.chosen];
    place("compared").hidden = chosen.length < 2;
    if (chosen.length < 2) return;
    const whole = made("table"), top = made("thead"), head = made("tr"), body = made("tbody");
    const letters = chosen.map((_, at) => String.fromCharCode(65 + at));
    head.append(made("th", "Metric"), ...letters.map((letter, at) => Object.assign(made("th", letter, "number"), { title: runs[chosen[at]].path })));
    head.append(...letters.slice(1).map((letter) => made("th", `${letter} \u2212 A`, "number")));
    top.append(head);
    const line = (title, cells) => {
      const row = made("tr"), first = made("td");
      first.append(made("code", title));
      row.append(first, ...cells.map((cell) => made("td", cell, "number")));
      body.append(row);
    };
    for (const name of names) {
      const values = chosen.map((at) => metrics[name][at]);
      if (values.every((value) => value === null)) continue;
      const off = values.slice(1).map((value) => (value === null || values[0] === null ? null : value - values[0]));
      line(name, [...values, ...off].map(number));
    }
    whole.append(top, body);
    const who = made("ul", undefined, "facts");
    chosen.forEach((at, n) => who.append(made("li", `${letters[n]}: ${runs[at].path}, ${runs[at].result}`)));
    place("comparison").replaceChildren(who, whole);
    const quoted = (path) => (/^[\w./+-]+$/.test(path) ? path : `'${path.replaceAll("'", "'\\''")}'`);
    place("command").textContent = `hilbench compare ${chosen.map((at) => quoted(runs[at].path)).join(" ")} --out compare.html`;
  };

  let plot = null;
  const draw = (rows) => {
    const name = metric();
    place("trend").hidden = !name;
    if (!name) return;
    const drawn = rows.filter((at) => metrics[name][at] !== null).sort((a, b) => runs[a].began_s - runs[b].began_s);
    const groups = [[PASSED, "--green"], ["completed", "--blue"], ["not passed", "--vermillion"]];
    const group = (run) => (groups.slice(0, 2).some(([label]) => label === run.result) ? run.result : "not passed");
    const of = ([label]) => drawn.map((at) => (group(runs[at]) === label ? metrics[name][at] : null));
    const data = [drawn.map((at) => runs[at].began_s), ...groups.map(of)];
    if (plot) plot.destroy();
    const points = (paint) => ({ show: true, size: 5, stroke: () => colour(paint), fill: () => colour(paint) });
    const value = (u, v) => (missing(v) ? "" : number(v));
    plot = new uPlot({
      width: place("plot").clientWidth || 900, height: 260, padding: [12, 14, 0, 0],
      series: [
        { label: "began" },
        ...groups.map(([label, paint]) => ({ label, paths: () => null, points: points(paint), stroke: () => colour(paint), value })),
      ],
      axes: [axis(12), { ...axis(12), label: name, labelSize: 18, size: 68 }],
      scales: { y: { range: (u, low, high) => height(low, high, null, 0, 0) } },
    }, data, place("plot"));
    let from = 0;
    plot.over.addEventListener("mousedown", (event) => { from = event.clientX; });
    plot.over.addEventListener("click", (event) => {
      const at = plot.cursor.idx;
      if (at === null || at === undefined || Math.abs(event.clientX - from) > 3) return;
      const run = runs[drawn[at]];
      if (run.link) location.href = run.link;
    });
  };

  const show = () => {
    const rows = found(), shown = Math.min(rows.length, state.rows);
    place("count").textContent = rows.length === runs.length ? `${runs.length} runs` : `${rows.length} of ${runs.length} runs`;
    const whole = place("runs");
    whole.replaceChildren(table(rows));
    if (shown < rows.length) {
      const more = made("button", `show ${Math.min(rows.length - shown, ROWS)} more of ${rows.length - shown}`, "more");
      more.type = "button";
      more.addEventListener("click", () => { state.rows += ROWS; show(); });
      whole.append(more);
    }
    draw(rows);
    document.documentElement.dataset.shown = rows.length;
  };

  const anew = () => { state.rows = ROWS; show(); };
  for (const id of ["words", "result", "metric", "least", "most"]) place(id).addEventListener("input", anew);
  place("finder").addEventListener("submit", (event) => event.preventDefault());
  place("finder").hidden = false;
  addEventListener("resize", () => plot && plot.setSize({ width: place("plot").clientWidth, height: 260 }));
  show();
})();
