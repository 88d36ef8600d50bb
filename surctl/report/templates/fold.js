"use strict";
/* Opens folded sections before printing, and when a link points into one. Without scripts the reader opens them. */
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
