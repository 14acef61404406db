(function () {
  "use strict";
  // --- Figures: each draws its panels as one SVG, when it comes near the window ---------------------------
  var LEFT = 58, RIGHT = 12, TOP = 8, GAP = 14, BOTTOM = 42;
  var DASH = {solid: "none", dash: "8 5", dot: "2 4"};

  function node(parent, name, attributes, text) {
    var made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (var key in attributes) made.setAttribute(key, attributes[key]);
    if (text !== undefined) made.textContent = text;
    return parent.appendChild(made);
  }

  function html(parent, name, className, text) {
    var made = document.createElement(name);
    made.className = className;
    if (text !== undefined) made.textContent = text;
    return parent.appendChild(made);
  }

  function shown(value) {
    return String(+value.toPrecision(4)).replace("-", "\u2212");
  }

  // Ticks at 1, 2, 5 of each decade, on a linear axis about `most` of them.
  function ticks(ends, log, most, step) {
    var out = [], low = ends[0], high = ends[1], decade, slack = 1e-9 * (high - low);
    if (log && high / low > 5) {
      for (decade = Math.floor(Math.log10(low)); decade <= Math.log10(high); decade++)
        [1, 2, 5].forEach(function (digit) { out.push(digit * Math.pow(10, decade)); });
    } else {
      if (!step || (high - low) / step > 2 * most || (high - low) / step < 2) {
        var unit = Math.pow(10, Math.floor(Math.log10((high - low) / most)));
        step = [1, 2, 5, 10].map(function (m) { return m * unit; })
          .find(function (s) { return (high - low) / s <= most; });
      }
      for (var i = Math.ceil(low / step - 1e-9); i * step <= high + slack; i++) out.push(i * step);
    }
    return out.filter(function (value) { return value >= low - slack && value <= high + slack; });
  }

  function Scale(ends, from, to, log) {
    var f = log ? Math.log : Number, a = f(ends[0]), b = f(ends[1]);
    this.at = function (value) { return from + (f(value) - a) / (b - a) * (to - from); };
    this.value = function (at) {
      var v = a + (at - from) / (to - from) * (b - a);
      return log ? Math.exp(v) : v;
    };
  }

  function Figure(element) {
    this.element = element;
    this.data = JSON.parse(element.parentNode.querySelector("script").textContent);
    this.off = {};
    this.legend = html(element, "div", "legend");
    this.svg = node(element, "svg", {role: "img"});
    this.readout = html(element, "div", "readout");
    this.reset();
    this.names();
    this.listen();
  }

  Figure.prototype.reset = function () {
    this.x = this.data.range;
    this.y = this.data.panels.map(function (panel) { return panel.range; });
  };

  // One entry of the legend a name; a click takes its curves away or brings them back.
  Figure.prototype.names = function () {
    var self = this, seen = {};
    this.data.panels.forEach(function (panel) {
      panel.curves.forEach(function (curve) {
        var first = seen[curve.name];
        if (first && !(first.pale && !curve.pale)) return;
        seen[curve.name] = curve;
      });
    });
    Object.keys(seen).forEach(function (name) {
      var entry = html(self.legend, "button", ""), key = node(entry, "svg", {width: 26, height: 10});
      entry.type = "button";
      entry.title = "show or hide";
      self.curve(key, seen[name], seen[name].marks ? [[13, 5]] : [[0, 5], [26, 5]]);
      entry.appendChild(document.createTextNode(name));
      entry.onclick = function () {
        self.off[name] = !self.off[name];
        entry.classList.toggle("off", self.off[name]);
        self.draw(self.width);
      };
    });
  };

  Figure.prototype.curve = function (parent, curve, points) {
    var opacity = curve.pale ? 0.45 : 1;
    if (curve.marks) {
      var ring = curve.marks === "ring";
      points.forEach(function (p) {
        node(parent, "circle", {
          cx: p[0], cy: p[1], r: ring ? 4.5 : 2.5, "stroke-width": 2, opacity: opacity,
          stroke: ring ? curve.colour : "none", fill: ring ? "none" : curve.colour});
      });
      return;
    }
    node(parent, "polyline", {
      points: points.map(function (p) { return p[0].toFixed(1) + "," + p[1].toFixed(1); }).join(" "),
      fill: "none", stroke: curve.colour, "stroke-width": curve.width, opacity: opacity,
      "stroke-dasharray": DASH[curve.dash], "stroke-linejoin": "round"});
  };

  Figure.prototype.draw = function (width) {
    var self = this, data = this.data, svg = this.svg, top = TOP, right = width - RIGHT;
    var height = TOP + BOTTOM + GAP * (data.panels.length - 1) +
      data.panels.reduce(function (sum, panel) { return sum + panel.height; }, 0);
    this.width = width;
    svg.replaceChildren();
    svg.setAttribute("viewBox", "0 0 " + width + " " + height);
    svg.setAttribute("aria-label", this.element.parentNode.querySelector("h3").textContent);
    this.across = new Scale(this.x, LEFT, right, data.log);
    this.panels = data.panels.map(function (panel, index) {
      var foot = top + panel.height, up = new Scale(self.y[index], foot, top), last = index === data.panels.length - 1;
      var clip = self.element.parentNode.id + "-" + index;
      node(node(svg, "clipPath", {id: clip}), "rect", {x: LEFT, y: top - 5, width: right - LEFT, height: panel.height + 10});
      ticks(self.x, data.log, Math.max(3, width / 90), 0).forEach(function (value) {
        var at = self.across.at(value);
        node(svg, "line", {x1: at, x2: at, y1: top, y2: foot, class: "grid"});
        if (last) node(svg, "text", {x: at, y: foot + 16, "text-anchor": "middle"}, shown(value));
      });
      ticks(self.y[index], false, panel.height / 26, panel.tick).forEach(function (value) {
        var at = up.at(value);
        node(svg, "line", {x1: LEFT, x2: right, y1: at, y2: at, class: "grid"});
        node(svg, "text", {x: LEFT - 6, y: at + 4, "text-anchor": "end"}, shown(value));
      });
      panel.guides.forEach(function (value) {
        var at = up.at(value);
        node(svg, "line", {x1: LEFT, x2: right, y1: at, y2: at, class: "guide"});
      });
      var inside = node(svg, "g", {"clip-path": "url(#" + clip + ")"});
      panel.curves.forEach(function (curve) {
        if (self.off[curve.name]) return;
        self.curve(inside, curve, curve.x.map(function (x, i) { return [self.across.at(x), up.at(curve.y[i])]; }));
      });
      var middle = top + panel.height / 2;
      node(svg, "text", {x: 12, y: middle, "text-anchor": "middle", transform: "rotate(-90 12 " + middle + ")"}, panel.title);
      var made = {top: top, foot: foot, up: up};
      top = foot + GAP;
      return made;
    });
    node(svg, "text", {x: (LEFT + right) / 2, y: height - 6, "text-anchor": "middle"}, data.title);
    this.pointer = node(svg, "g", {});
  };

  // Where a pointer is: panel, and the nearest point of a curve on the screen, between its corners.
  Figure.prototype.nearest = function (x, y) {
    var self = this, best = null;
    var index = this.panels.findIndex(function (panel) { return y >= panel.top - 5 && y <= panel.foot + 5; });
    if (index < 0) return null;
    this.data.panels[index].curves.forEach(function (curve) {
      if (self.off[curve.name]) return;
      var up = self.panels[index].up, at = self.across.value(x), i = 0;
      function offer(px, value) {
        var d = Math.hypot(self.across.at(px) - x, up.at(value) - y);
        if (!best || d < best.d) best = {d: d, x: px, y: value, curve: curve, up: up};
      }
      if (curve.marks) { curve.x.forEach(function (px, k) { offer(px, curve.y[k]); }); return; }
      while (i < curve.x.length && curve.x[i] < at) i++;
      if (i === 0 || i === curve.x.length) return;
      var from = self.across.at(curve.x[i - 1]), to = self.across.at(curve.x[i]);
      offer(at, curve.y[i - 1] + (curve.y[i] - curve.y[i - 1]) * (x - from) / (to - from));
    });
    return best && best.d < 40 ? best : null;
  };

  Figure.prototype.listen = function () {
    var self = this, svg = this.svg, start = null;
    function at(event) {
      var box = svg.getBoundingClientRect();
      return {x: (event.clientX - box.left) * self.width / box.width, y: (event.clientY - box.top) * self.width / box.width};
    }
    svg.addEventListener("pointermove", function (event) {
      var p = at(event), found = start ? null : self.nearest(p.x, p.y);
      self.pointer.replaceChildren();
      self.readout.textContent = "";
      if (start) {
        node(self.pointer, "rect", {x: Math.min(p.x, start.x), y: Math.min(p.y, start.y),
          width: Math.abs(p.x - start.x), height: Math.abs(p.y - start.y), class: "box"});
      } else if (found) {
        node(self.pointer, "circle", {cx: self.across.at(found.x), cy: found.up.at(found.y), r: 4, fill: found.curve.colour});
        self.readout.textContent = shown(found.x) + ", " + shown(found.y) + "  " + found.curve.name;
      }
    });
    svg.addEventListener("pointerleave", function () { self.pointer.replaceChildren(); self.readout.textContent = ""; start = null; });
    svg.addEventListener("pointerdown", function (event) {
      if (event.pointerType === "mouse" && event.button === 0) { start = at(event); event.preventDefault(); }
    });
    svg.addEventListener("pointerup", function (event) {
      var p = at(event), from = start;
      start = null;
      if (!from || Math.abs(p.x - from.x) < 8) return self.pointer.replaceChildren();
      function inside(x) { return self.across.value(Math.min(Math.max(x, LEFT), self.width - RIGHT)); }
      self.x = [inside(Math.min(p.x, from.x)), inside(Math.max(p.x, from.x))];
      self.panels.forEach(function (panel, index) {
        if (from.y < panel.top || from.y > panel.foot || Math.abs(p.y - from.y) < 8) return;
        var end = Math.min(Math.max(p.y, panel.top), panel.foot);
        self.y[index] = [panel.up.value(Math.max(end, from.y)), panel.up.value(Math.min(end, from.y))];
      });
      self.draw(self.width);
    });
    svg.addEventListener("dblclick", function () { self.reset(); self.draw(self.width); });
  };

  var plots = Array.from(document.querySelectorAll(".plot")), figures = new Map();
  function draw(element, width) {
    if (!figures.has(element)) figures.set(element, new Figure(element));
    figures.get(element).draw(width || element.clientWidth);
  }
  var seen = new IntersectionObserver(function (entries) {
    entries.forEach(function (entry) {
      if (entry.isIntersecting) { seen.unobserve(entry.target); draw(entry.target); }
    });
  }, {rootMargin: "800px"});
  plots.forEach(function (element) { seen.observe(element); });
  function redraw() {
    figures.forEach(function (figure, element) { if (element.clientWidth) draw(element); });
  }
  addEventListener("resize", redraw);
  addEventListener("beforeprint", function () { plots.forEach(function (element) { draw(element, 900); }); });
  addEventListener("afterprint", redraw);

  // --- Filters: chapters as a whole, rows of tables by their verdict ------------------------------------------
  var chapter = document.getElementById("chapter"), verdict = document.getElementById("verdict");
  var count = document.getElementById("count");
  function of(link) { return document.getElementById(link.hash.slice(1)); }
  function filter(event) {
    var rows = 0, wanted = verdict.value;
    document.querySelectorAll("main > section:not(#summary)").forEach(function (section) {
      var left = !wanted;
      section.querySelectorAll(".block").forEach(function (block) {
        var some = !wanted;
        block.querySelectorAll("tbody tr").forEach(function (row) {
          row.hidden = Boolean(wanted) && !row.querySelector("td." + wanted);
          some = some || !row.hidden;
        });
        block.hidden = !some;
        left = left || some;
      });
      section.hidden = !left || Boolean(chapter.value) && section.id !== chapter.value;
      if (wanted && !section.hidden) rows += section.querySelectorAll("td." + wanted).length;
    });
    document.querySelectorAll("nav a").forEach(function (link) {
      var target = of(link);
      link.parentNode.hidden = target.hidden || target.closest("section").hidden;
    });
    count.textContent = wanted ? rows + " rows, other readings included" : "";
    redraw();
    var first = event && document.querySelector("main > section:not(#summary):not([hidden])");
    if (first) first.scrollIntoView();
  }
  function clear() { chapter.value = verdict.value = ""; filter(); }
  chapter.onchange = verdict.onchange = filter;
  addEventListener("pageshow", function () { filter(); });
  // A link to what is filtered out takes the filter off.
  document.addEventListener("click", function (event) {
    var link = event.target.closest('a[href^="#"]'), target = link && of(link);
    if (target && !target.offsetParent) clear();
  });
})();
