// The search of the site, which works in pages that were opened from a file, too. A browser lets those load scripts, but
// start no worker and fetch no JSON, as mkdocs' own search would: tools/docs_hook.py writes the index as a script.
"use strict";

const MOST = 50;
const AROUND = 100;

function load(script) {
  return new Promise((resolve, reject) => {
    const element = document.createElement("script");
    element.src = `${base_url}/search/${script}`;
    element.onload = resolve;
    element.onerror = () => reject(new Error(`${element.src} can't be loaded`));
    document.head.append(element);
  });
}

function makeIndex(docs) {
  return lunr(function () {
    this.ref("location");
    this.field("title", { boost: 5 });
    this.field("text");
    this.pipeline.remove(lunr.stemmer);
    this.searchPipeline.remove(lunr.stemmer);
    docs.forEach((doc) => this.add(doc));
  });
}

// Whole words count most, then beginnings of words, then other forms of a word (stops, stopped).
function find(index, words) {
  return index.query((query) => {
    for (const word of words) {
      query.term(word, { boost: 10 });
      query.term(word, { boost: 3, wildcard: lunr.Query.wildcard.TRAILING });
      query.term(lunr.stemmer(new lunr.Token(word)).toString(), { wildcard: lunr.Query.wildcard.TRAILING });
    }
  });
}

function excerpt(text, words) {
  const at = Math.max(0, text.toLowerCase().indexOf(words[0]));
  const start = at > AROUND ? text.indexOf(" ", at - AROUND) + 1 : 0;
  const end = text.indexOf(" ", at + AROUND);
  return `${start ? "… " : ""}${text.slice(start, end < 0 ? undefined : end)}${end < 0 ? "" : " …"}`;
}

function show(found, docs, words, results) {
  results.replaceChildren(
    ...found.slice(0, MOST).map(({ ref }) => {
      const doc = docs.get(ref);
      const article = document.createElement("article");
      const link = document.createElement("a");
      link.href = `${base_url}/${ref}`;
      link.textContent = doc.title;
      const heading = document.createElement("h3");
      heading.append(link);
      const text = document.createElement("p");
      text.textContent = excerpt(doc.text, words);
      article.append(heading, text);
      return article;
    }),
  );
  if (!found.length) {
    results.textContent = results.dataset.noResultsText;
  }
}

async function start(results) {
  const field = document.getElementById("mkdocs-search-query");
  field.value = new URLSearchParams(location.search).get("q") ?? "";
  await Promise.all([load("lunr.js"), load("search_index.js")]);
  lunr.tokenizer.separator = /[\s]+/;
  const docs = new Map(SEARCH_INDEX.docs.map((doc) => [doc.location, doc]));
  const index = makeIndex(SEARCH_INDEX.docs);
  const search = () => {
    const words = field.value.toLowerCase().split(/\s+/).map((word) => word.replace(/^\W+|\W+$/g, "")).filter(Boolean);
    show(words.length ? find(index, words) : [], docs, words, results);
  };
  field.addEventListener("input", search);
  search();
}

const results = document.getElementById("mkdocs-search-results");
if (results) {
  start(results).catch((error) => { results.textContent = error.message; });
}
