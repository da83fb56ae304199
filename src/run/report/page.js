// Cursor and zoom of charts, enlarged pictures. Everything on the page can be read without it.
(() => {
'use strict';
const element = (svg, name, attributes) => {
  const made = document.createElementNS(svg.namespaceURI, name);
  for (const key in attributes) made.setAttribute(key, attributes[key]);
  return made;
};

// An axis from `from` to `to` (log10 of the ends if `log`), in shown units of `each` base units.
const spell = (axis, span, value) => {
  const shown = axis.log ? Number(value.toPrecision(3)) :
    value.toFixed(Math.min(6, Math.max(0, Math.ceil(-Math.log10(span / 400 || 1)))));
  const text = Math.abs(shown) >= 1e4 ? Math.round(shown).toLocaleString('en').replace(/,/g, '\u202f') : String(shown);
  return text.replace('-', '\u2212') + (axis.unit ? ' ' + axis.unit : '');
};
const step = (span, count) => {
  const rough = span / count, power = 10 ** Math.floor(Math.log10(rough)), r = rough / power;
  return power * (r <= 1 ? 1 : r <= 2 ? 2 : r <= 5 ? 5 : 10);
};

const charts = [];
class Chart {
  constructor(figure, svg) {
    this.svg = svg;
    [this.x, this.y] = JSON.parse(svg.dataset.axes);
    [this.left, this.top, this.right, this.bottom] = JSON.parse(svg.dataset.frame);
    this.values = [...figure.querySelectorAll('figcaption span')].map(s => s.querySelector('b'));
    this.texts = this.values.map(b => b && b.textContent);
    this.lines = [...svg.querySelectorAll('polyline.line:not(.thin)')];
    this.points = this.lines.map(l => [...l.points].map(p => [p.x, p.y]));
    this.drawn = [...svg.querySelectorAll('polyline, polygon')].map(e => [e, [...e.points].map(p => [p.x, p.y]), e.getAttribute('points')]);
    this.marks = svg.querySelectorAll('.mark, .label');
    this.grid = svg.querySelectorAll('.grid, .tick');
    const clip = 'clip' + charts.length, at = {x: this.left, y: this.top, width: this.right - this.left, height: this.bottom - this.top};
    const path = element(svg, 'clipPath', {id: clip});
    path.append(element(svg, 'rect', at));
    svg.append(path);
    for (const [e] of this.drawn) e.setAttribute('clip-path', `url(#${clip})`);
    this.own = element(svg, 'g', {});
    this.cursor = element(svg, 'g', {class: 'cursor'});
    this.select = element(svg, 'rect', {class: 'select', y: this.top, height: at.height, width: 0});
    svg.append(this.own, this.select, this.cursor);
    this.whole = {x: [this.x.from, this.x.to], y: [this.y.from, this.y.to]};
    this.view = this.whole;
    svg.addEventListener('pointermove', e => {
      if (!e.buttons) this.drop();
      this.moved(this.place(e));
    });
    svg.addEventListener('pointerleave', () => { if (!this.start) point(this, null); });
    svg.addEventListener('pointerdown', e => {
      if (e.button) return;
      if (e.pointerType === 'touch') return this.moved(this.place(e));
      this.start = this.place(e);
      svg.setPointerCapture(e.pointerId);
    });
    svg.addEventListener('pointerup', e => this.selected(this.place(e)));
    svg.addEventListener('pointercancel', () => this.drop());
    svg.addEventListener('dblclick', () => zoom(this, null));
  }
  drop() {
    this.start = null;
    this.select.setAttribute('width', 0);
  }
  place(event) {
    const matrix = this.svg.getScreenCTM();
    const x = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix.inverse()).x;
    return Math.min(this.right, Math.max(this.left, x));
  }
  // Where a point drawn for the whole range lies now, and back.
  shift([x, y]) {
    const part = (v, a, b, [from, to], [f, t]) => a + (b - a) * ((from + (to - from) * (v - a) / (b - a)) - f) / (t - f);
    return [part(x, this.left, this.right, this.whole.x, this.view.x), part(y, this.bottom, this.top, this.whole.y, this.view.y)];
  }
  axis_x(pixel) {
    const [f, t] = this.view.x;
    return f + (t - f) * (pixel - this.left) / (this.right - this.left);
  }
  axis_y(pixel) {
    const [f, t] = this.view.y;
    return f + (t - f) * (this.bottom - pixel) / (this.bottom - this.top);
  }
  pixel_x(value) {
    const [f, t] = this.view.x;
    return this.left + (value - f) / (t - f) * (this.right - this.left);
  }
  moved(x) {
    if (this.start) {
      this.select.setAttribute('x', Math.min(x, this.start));
      this.select.setAttribute('width', Math.abs(x - this.start));
    }
    point(this, this.axis_x(x));
  }
  selected(x) {
    const start = this.start;
    this.drop();
    if (start && Math.abs(x - start) > 6) zoom(this, [this.axis_x(Math.min(x, start)), this.axis_x(Math.max(x, start))]);
  }
  // Shows the values at a position of the axis, or takes them away.
  show(at) {
    this.cursor.replaceChildren();
    this.values.forEach((b, k) => { if (b) b.textContent = this.texts[k]; });
    if (at === null) return;
    const x = this.pixel_x(at);
    if (!(x >= this.left - 1e-6 && x <= this.right + 1e-6)) return;
    const line = element(this.svg, 'line', {x1: x, x2: x, y1: this.top, y2: this.bottom});
    const label = element(this.svg, 'text', {x: this.left, y: this.bottom + 33});
    const real = (axis, v) => axis.log ? 10 ** v : v;
    label.textContent = spell(this.x, this.view.x[1] - this.view.x[0], real(this.x, at));
    this.cursor.append(line, label);
    this.points.forEach((points, k) => {
      const moved = points.map(p => this.shift(p)).filter(p => p[0] >= this.left - 0.1 && p[0] <= this.right + 0.1);
      if (this.values[k]) this.values[k].textContent = '\u2013';
      if (!moved.length) return;
      const near = moved.reduce((a, b) => Math.abs(b[0] - x) < Math.abs(a[0] - x) ? b : a);
      const ring = element(this.svg, 'circle', {cx: near[0], cy: near[1], r: 4, class: this.lines[k].classList[1]});
      this.cursor.append(ring);
      const span = this.view.y[1] - this.view.y[0];
      if (this.values[k]) this.values[k].textContent = spell(this.y, span, real(this.y, this.axis_y(near[1])));
    });
  }
  // Lays the axes over a range of x and what there is of y in it; over everything without one.
  zoom(range) {
    this.view = this.whole;
    let view = this.whole;
    // Numbers have no more digits.
    if (range && range[1] - range[0] > 1e-6 * (this.whole.x[1] - this.whole.x[0])) {
      const xs = range.map(v => this.pixel_x(v));
      const ys = this.points.flat().filter(p => p[0] >= xs[0] && p[0] <= xs[1]).map(p => this.axis_y(p[1]));
      if (ys.length) {
        const low = Math.min(...ys), high = Math.max(...ys);
        const room = 0.08 * (high - low) || 0.02 * (this.whole.y[1] - this.whole.y[0]);
        view = {x: range, y: [low - room, high + room]};
      }
    }
    this.view = view;
    const zoomed = view !== this.whole;
    for (const [e, points, whole] of this.drawn)
      e.setAttribute('points', zoomed ? points.map(p => this.shift(p).join()).join(' ') : whole);
    for (const e of [...this.marks, ...this.grid]) e.style.display = zoomed ? 'none' : '';
    this.own.replaceChildren();
    if (zoomed) this.ticks();
  }
  ticks() {
    const {svg, own} = this;
    for (const [axis, [from, to], count, across] of [[this.x, this.view.x, 4, true], [this.y, this.view.y, 4, false]]) {
      const by = step(to - from, count);
      for (let v = Math.ceil(from / by) * by; v <= to; v += by) {
        const share = (v - from) / (to - from);
        const px = this.left + share * (this.right - this.left), py = this.bottom - share * (this.bottom - this.top);
        const d = across ? `M${px} ${this.top}V${this.bottom}` : `M${this.left} ${py}H${this.right}`;
        const text = element(svg, 'text', across ? {x: px, y: this.bottom + 15, 'text-anchor': 'middle'} :
          {x: this.left - 6, y: py + 4, 'text-anchor': 'end'});
        const shown = axis.log ? Number((10 ** v).toPrecision(2)) : Number((Math.round(v / by) * by).toPrecision(6));
        text.textContent = String(Math.abs(shown) >= 1e4 ? Number((shown / 1e3).toPrecision(4)) + 'k' : shown).replace('-', '\u2212');
        own.append(element(svg, 'path', {class: 'grid', d}), text);
      }
    }
  }
}
// The same for all charts of one quantity.
const alike = chart => charts.filter(c => c.x.label === chart.x.label && c.x.log === chart.x.log);
const point = (chart, at) => {
  for (const other of alike(chart)) other.show(at === null ? null : at * chart.x.each / other.x.each);
};
const zoom = (chart, range) => {
  for (const other of alike(chart)) other.zoom(range && range.map(v => v * chart.x.each / other.x.each));
};
for (const svg of document.querySelectorAll('svg[data-axes]')) charts.push(new Chart(svg.closest('figure'), svg));

// Enlarged pictures of a view: the photo over the render up to a line that follows the pointer, or the error.
const views = [...document.querySelectorAll('.view')];
if (views.length) {
  const dialog = document.createElement('dialog');
  dialog.className = 'large';
  const head = document.createElement('p'), stage = document.createElement('div'), bar = document.createElement('p');
  const [render, photo, error] = [0, 1, 2].map(() => document.createElement('img'));
  const slider = Object.assign(document.createElement('input'), {type: 'range', min: 0, max: 100, value: 50, ariaLabel: 'photo on the left, render on the right'});
  const button = (text, act) => {
    const made = Object.assign(document.createElement('button'), {type: 'button', textContent: text});
    made.addEventListener('click', act);
    return made;
  };
  let now = 0;
  const split = share => {
    slider.value = share;
    photo.style.clipPath = `inset(0 ${100 - share}% 0 0)`;
    stage.style.setProperty('--at', share + '%');
  };
  const wrong = on => { dialog.classList.toggle('wrong', on); };
  const open = k => {
    now = (k + views.length) % views.length;
    const source = name => views[now].querySelector(`img[alt="${name}"]`);
    for (const [to, name] of [[render, 'render'], [photo, 'photo'], [error, 'error']]) {
      to.src = source(name).src;
      to.alt = name;
    }
    const size = source('render');
    stage.style.setProperty('--ratio', size.getAttribute('width') / size.getAttribute('height'));
    head.textContent = [...views[now].querySelector('h3').childNodes].map(n => n.textContent).join('  \u00b7  ');
    split(50);
    if (!dialog.open) dialog.showModal();
  };
  slider.addEventListener('input', () => split(slider.value));
  stage.addEventListener('pointermove', e => {
    if (e.pointerType === 'touch' && !e.isPrimary) return;
    const box = stage.getBoundingClientRect();
    split(Math.min(100, Math.max(0, 100 * (e.clientX - box.left) / box.width)));
  });
  const next = by => () => open(now + by);
  bar.append(slider, button('\u2190', next(-1)), button('\u2192', next(1)),
    button('error', () => wrong(!dialog.classList.contains('wrong'))), button('close', () => dialog.close()));
  dialog.addEventListener('keydown', e => {
    if (e.target === slider) return;
    if (e.key === 'ArrowLeft') open(now - 1);
    if (e.key === 'ArrowRight') open(now + 1);
    if (e.key === 'e') wrong(!dialog.classList.contains('wrong'));
  });
  dialog.addEventListener('click', e => { if (e.target === dialog) dialog.close(); });
  stage.append(render, photo, error);
  dialog.append(head, stage, bar);
  document.body.append(dialog);
  views.forEach((view, k) => {
    for (const img of view.querySelectorAll('img')) {
      img.classList.add('opens');
      img.addEventListener('click', () => { wrong(img.alt === 'error'); open(k); });
    }
  });
}
})();
