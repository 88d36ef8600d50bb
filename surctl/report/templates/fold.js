"use strict";
/* Folded sections open for paper, and where a link leads into one. Without a script the reader opens them by hand. */
(() => {
  const all = () => [...document.querySelectorAll("details:not([open])")];
  let opened = [];
  const reveal = () => {
    const aim = document.getElementById(location.hash.slice(1));
    if (!aim) return;
    const inner = aim.querySelector(":scope > details");
    for (let at = inner || aim; at; at = at.parentElement) if (at.tagName === "DETAILS") at.open = true;
    aim.scrollIntoView();
  };
  addEventListener("beforeprint", () => { opened = all(); opened.forEach((one) => { one.open = true; }); });
  addEventListener("afterprint", () => { opened.forEach((one) => { one.open = false; }); opened = []; });
  addEventListener("hashchange", reveal);
  reveal();
})();
