"use strict";
/* Plays the run of each element [data-player], which contains the frames as JSON. Without scripts the page shows the
   still picture. */
(() => {
  const calm = matchMedia("(prefers-reduced-motion: reduce)");

  function start(root) {
    const data = JSON.parse(root.querySelector('script[type="application/json"]').textContent);
    const find = (name) => root.querySelector("." + name);
    const plan = find("plan"), strip = find("strip"), play = find("play"), scrub = find("scrub");
    const pace = find("pace"), readout = find("readout");
    const last = data.time.length - 1, end = data.time[last];
    const film = root.querySelectorAll(".film img");
    let now = 0, clock = null, shown = 0;

    function draw(parent, tag, name, attributes) {
      const element = document.createElementNS(plan.namespaceURI, tag);
      if (name) element.setAttribute("class", name);
      set(element, attributes);
      parent.append(element);
      return element;
    }
    function set(element, attributes) {
      for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    }
    const points = (pairs) => pairs.map((p) => p.join(",")).join(" ");

    const [length, width] = data.site, rim = 0.02 * Math.max(length, width);
    set(plan, { viewBox: [-rim, -width - rim, length + 2 * rim, width + 2 * rim].join(" ") });
    const world = draw(plan, "g", "", { transform: "scale(1,-1)" });
    draw(world, "rect", "water", { x: 0, y: 0, width: length, height: width });
    let grid = "";
    for (let x = data.grid; x < length - 1e-9; x += data.grid) grid += `M${x} 0V${width}`;
    for (let y = data.grid; y < width - 1e-9; y += data.grid) grid += `M0 ${y}H${length}`;
    draw(world, "path", "grid", { d: grid });
    const beams = data.beams.map(() => draw(world, "path", "beam", {}));
    const far = 20 * Math.max(length, width);  // the ground hides beams beyond the walls, also beside the view
    const outer = `M${-far} ${-far}H${length + far}V${width + far}H${-far}Z`;
    draw(world, "path", "ground", { d: `${outer}M0 0H${length}V${width}H0Z`, "fill-rule": "evenodd" });
    draw(world, "rect", "edge", { x: 0, y: 0, width: length, height: width });
    draw(world, "polyline", "route", { points: points(data.path) });
    draw(world, "polyline", "track", { points: points(data.place) });
    const bodies = data.obstacles.map((o) => {
      const element = o.radius === undefined
        ? draw(world, "polygon", "body", { points: points(o.corners) })
        : draw(world, "circle", "body", { r: o.radius });
      draw(element, "title", "", {}).textContent = o.name;
      return element;
    });
    const trail = draw(world, "polyline", "trail", {});
    const target = data.path[data.path.length - 1], side = data.radius / 4;
    draw(world, "circle", "target", { cx: target[0], cy: target[1], r: side });
    const hull = draw(world, "g", "hull", {});
    draw(hull, "circle", "", { r: data.radius });
    draw(hull, "line", "", { x1: 0, y1: 0, x2: data.radius, y2: 0 });

    const heights = data.clearance.filter((c) => c !== null);
    const top = Math.max(0.1, ...heights) * 1.05, bottom = Math.min(0, ...heights) - 0.08 * top;
    const level = (c) => 100 * (top - c) / (top - bottom);
    const across = (t) => end > 0 ? 1000 * t / end : 0;
    set(strip, { viewBox: "0 0 1000 100", preserveAspectRatio: "none" });
    draw(strip, "line", "contact", { x1: 0, x2: 1000, y1: level(0), y2: level(0) });
    let curve = "", up = true;
    data.clearance.forEach((c, k) => {
      if (c !== null) curve += (up ? "M" : "L") + across(data.time[k]).toFixed(1) + " " + level(c).toFixed(1);
      up = c === null;
    });
    draw(strip, "path", "curve", { d: curve });
    const cursor = draw(strip, "line", "cursor", { y1: 0, y2: 100 });

    function between(a, b, share) { return a + (b - a) * share; }
    function frame(t) {
      let k = 0, above = last;
      while (above - k > 1) {
        const middle = (k + above) >> 1;
        if (data.time[middle] <= t) k = middle; else above = middle;
      }
      if (last === 0 || t >= data.time[above]) return [above, above, 0];
      return [k, above, (t - data.time[k]) / (data.time[above] - data.time[k])];
    }

    function show(t) {
      now = Math.min(Math.max(t, 0), end);
      const [k, next, share] = frame(now);
      const at = data.place[k].map((v, axis) => between(v, data.place[next][axis], share));
      const turn = Math.atan2(Math.sin(data.heading[next] - data.heading[k]), Math.cos(data.heading[next] - data.heading[k]));
      const heading = data.heading[k] + turn * share;
      set(hull, { transform: `translate(${at.join(" ")}) rotate(${heading * 180 / Math.PI})` });
      set(trail, { points: points([...data.place.slice(0, k + 1), at]) });
      data.obstacles.forEach((o, n) => {
        const here = o.at.length === 1 ? o.at[0] : o.at[k], then = o.at.length === 1 ? here : o.at[next] || here;
        bodies[n].style.display = here ? "" : "none";
        if (here) set(bodies[n], { transform: `translate(${between(here[0], then[0], share)} ${between(here[1], then[1], share)})` });
      });
      data.beams.forEach((b, n) => {
        const range = Math.abs(b.length[k]), axis = heading + b.axis;
        const x = at[0] + b.apex[0] * Math.cos(heading) - b.apex[1] * Math.sin(heading);
        const y = at[1] + b.apex[0] * Math.sin(heading) + b.apex[1] * Math.cos(heading);
        const end = (angle) => `${x + range * Math.cos(angle)} ${y + range * Math.sin(angle)}`;
        const arc = `A${range} ${range} 0 ${b.half > Math.PI / 2 ? 1 : 0} 1 ${end(axis + b.half)}`;
        set(beams[n], { d: `M${x} ${y}L${end(axis - b.half)}${arc}Z`, class: b.length[k] < 0 ? "beam silent" : "beam" });
      });
      set(cursor, { x1: across(now), x2: across(now) });
      if (film.length > 0) {
        let scene = 0;
        while (scene + 1 < film.length && data.filmed[scene + 1] <= now + 1e-9) scene += 1;
        film[shown].hidden = true;
        film[scene].hidden = false;
        shown = scene;
      }
      const clear = data.clearance[k];
      plan.dataset.time = now.toFixed(2);
      const words = [`${now.toFixed(1)} of ${end.toFixed(1)} s`];
      if (clear !== null) words.push(`clearance ${clear.toFixed(2)} m`);
      words.push(`${data.speed[k].toFixed(2)} m/s`);
      if (data.avoiding[k]) words.push("avoiding");
      readout.textContent = words.join(", ");
      scrub.value = now;
      scrub.setAttribute("aria-valuetext", `${now.toFixed(1)} seconds`);
    }

    function stop() {
      if (clock !== null) cancelAnimationFrame(clock);
      clock = null;
      play.textContent = "Play";
    }
    function run() {
      const begun = performance.now(), from = now >= end ? 0 : now, fast = Number(pace.value);
      play.textContent = "Pause";
      const step = () => {
        let passed = (performance.now() - begun) / 1000;
        if (calm.matches) passed = Math.floor(passed); /* show whole seconds instead of a motion */
        show(from + passed * fast);
        if (now >= end) stop(); else clock = requestAnimationFrame(step);
      };
      clock = requestAnimationFrame(step);
    }

    play.addEventListener("click", () => clock === null ? run() : stop());
    pace.addEventListener("change", () => { if (clock !== null) { stop(); run(); } });
    scrub.addEventListener("input", () => { stop(); show(end - scrub.value < scrub.step ? end : Number(scrub.value)); });
    find("closest").addEventListener("click", () => { stop(); show(data.time[data.closest]); });
    addEventListener("beforeprint", stop);
    scrub.max = end;
    show(0);
    find("stage").hidden = false;
    root.classList.add("live");
  }

  document.querySelectorAll("[data-player]").forEach(start);
})();
