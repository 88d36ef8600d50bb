// The selector of the version; window.surctlVersions is the list that publish.py writes: version → its pages.
(() => {
  const { version, page, root } = document.currentScript.dataset;
  const versions = window.surctlVersions ?? {};
  const header = document.querySelector(".md-header__inner");
  if (!header || !(version in versions)) return;
  const select = document.createElement("select");
  select.className = "versions";
  select.setAttribute("aria-label", "Version of this documentation");
  for (const name of Object.keys(versions)) select.add(new Option(name, name, name === version, name === version));
  select.addEventListener("change", () => {
    const same = versions[select.value].includes(page) ? page : "index.html"; // a page may be new
    location.href = `${root}../${select.value}/${same}`;
  });
  header.querySelector(".md-header__title").after(select);
})();
