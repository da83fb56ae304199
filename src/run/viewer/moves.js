// Moving about in a scene, in every page that shows one: the page's own script, which comes after this one, has `step` (a frame), `arrive`
// (the camera has jumped), `aim` (the pivot goes to what is under a pixel) and `near`.
// Axes are those of the kernels: x right, y down, z forward; rotations are three rows, scene to camera; lengths are local units.
'use strict';
const $ = (id) => document.getElementById(id);
const scene = JSON.parse($('meta').textContent);
// The keys and values of the address behind #. Only %xx stands for something else: a + in a name is a plus.
function hash() {
  const plain = (text) => {
    try { return decodeURIComponent(text); } catch { return text; }
  };
  const pair = (part) => part.match(/^([^=]*)=?(.*)$/s).slice(1).map(plain);
  return new Map(location.hash.slice(1).split('&').map(pair));
}

// Writes the camera, the photo and the quantity into the address: they are there again when the page is loaded again.
function remember() {
  const parts = hash(), mode = $('shown')?.value;
  parts.delete('');
  parts.set('view', scene.cameras[current].name);
  if (comparing) parts.set('photo', ''); else parts.delete('photo');
  if (mode) parts.set('mode', mode);
  const spelt = (text) => text.replace(/[%&=]/g, encodeURIComponent);
  const pair = ([key, value]) => (value === '' ? spelt(key) : `${spelt(key)}=${spelt(value)}`);
  // A page within another has no address of its own.
  try { history.replaceState(null, '', '#' + [...parts].map(pair).join('&')); } catch { /* as it was */ }
}

function say(text) {
  $('message').textContent = text;
  $('message').hidden = false;
  $('bar').hidden = true;
}

// Vectors and rotations.
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const add = (a, b, k) => [a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => add([0, 0, 0], a, 1 / (Math.hypot(...a) || 1));
// v turned about a unit axis (Rodrigues).
function turned(v, axis, angle) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return add(add(add([0, 0, 0], v, c), cross(axis, v), s), axis, dot(axis, v) * (1 - c));
}
// Rows made orthonormal again, so that rounding does not add up.
function upright([, y, z]) {
  z = unit(z);
  const x = unit(cross(y, z));
  return [x, cross(z, x), z];
}

const canvas = $('canvas');

// The view: place and direction, the lens of a camera, and the point that it turns about.
const view = { rows: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], center: [0, 0, 0], lens: null, pivot: [0, 0, 0] };
let current = -1, moved = false, comparing = false, split = 0.5, looking = false, coarse = 1;

// The lens on a canvas of this size: the photo's frame as large as fits, in the middle.
function lens(width, height) {
  const { size, lens: [fx, fy, cx, cy] } = view.lens, k = Math.min(width / size[0], height / size[1]);
  const left = (width - size[0] * k) / 2, top = (height - size[1] * k) / 2;
  return { fx: fx * k, fy: fy * k, cx: cx * k + left, cy: cy * k + top, left, top, width: size[0] * k, height: size[1] * k };
}

const translation = () => view.rows.map((row) => -dot(row, view.center));

// Frames: only when something has changed.
let waiting = false, moving = 0;
function frame() {
  if (!waiting) requestAnimationFrame(step);
  waiting = true;
}

// Called on every movement: coarse pixels, if the device is slow, until it rests.
function move() {
  moved = true;
  clearTimeout(moving);
  moving = setTimeout(() => { moving = 0; coarse = 1; frame(); }, 250);
  frame();
}

// Words.
const number = (n) => n.toLocaleString('en').replaceAll(',', '\u202f');
function tellView() {
  const camera = scene.cameras[current], parts = [camera.held_out ? 'held-out' : 'training'];
  if (camera.psnr !== null) parts.push(`PSNR ${camera.psnr.toFixed(2)} dB`, `SSIM ${camera.ssim.toFixed(3)}`);
  const name = document.createElement('b');
  name.textContent = camera.name;
  $('view').replaceChildren(...(moved ? ['moved from ', name, ' (R: back)'] : [name, ' · ' + parts.join(' · ')]));
  $('compare').disabled = !camera.photo;
  $('compare').setAttribute('aria-pressed', photoShown());
  $('mode').textContent = looking ? 'Look' : 'Orbit';
}

const photoShown = () => comparing && !moved && Boolean(scene.cameras[current].photo);

function placePhoto([width, height]) {
  const camera = scene.cameras[current], shown = photoShown();
  $('photo').hidden = !shown;
  if (!shown) return;
  if ($('picture').getAttribute('src') !== camera.photo) $('picture').src = camera.photo;
  const l = lens(width, height);
  Object.assign($('photo').style, { left: l.left + 'px', top: l.top + 'px', width: l.width + 'px', height: l.height + 'px' });
  $('picture').style.clipPath = `inset(0 ${100 * (1 - split)}% 0 0)`;
  $('split').style.left = 100 * split + '%';
}

function show(k) {
  const n = scene.cameras.length, camera = scene.cameras[(current = ((k % n) + n) % n)];
  const r = camera.rotation;
  view.rows = [r.slice(0, 3), r.slice(3, 6), r.slice(6, 9)];
  view.center = camera.center;
  view.lens = camera;
  moved = false;
  $('cameras').value = current;
  arrive();
  aim(innerWidth / 2, innerHeight / 2);
  frame();
}

// Movements. Dragging takes hold of the scene.
function turn(dx, dy) {
  const sign = looking ? 1 : -1, about = looking ? view.center : view.pivot, k = 0.005;
  const spin = (axis, angle) => {
    const rows = upright(view.rows.map((row) => turned(row, axis, angle)));
    // Not over the poles.
    if (Math.abs(dot(rows[2], scene.up)) > 0.995 && Math.abs(dot(rows[2], scene.up)) > Math.abs(dot(view.rows[2], scene.up))) return;
    view.center = add(about, turned(add(view.center, about, -1), axis, angle), 1);
    view.rows = rows;
  };
  spin(scene.up, sign * dx * k);
  spin(view.rows[0], sign * dy * k);
  move();
}

function shift(dx, dy) {
  const l = lens(innerWidth, innerHeight), depth = Math.max(Math.abs(dot(view.rows[2], add(view.pivot, view.center, -1))), 2 * near);
  let by = add([0, 0, 0], view.rows[0], (-dx * depth) / l.fx);
  by = add(by, view.rows[1], (-dy * depth) / l.fy);
  carry(by);
}

function carry(by) {
  view.center = add(view.center, by, 1);
  view.pivot = add(view.pivot, by, 1);
  move();
}

// Nearer to the pivot; what is very near is pushed along.
function approach(factor) {
  const away = add(view.center, view.pivot, -1), distance = Math.hypot(...away);
  const step = distance * (factor - 1), least = 8 * near;
  view.center = add(view.center, unit(away), step);
  if (distance + step < least) view.pivot = add(view.center, view.rows[2], least);
  move();
}

const held = new Set();
function fly(seconds) {
  const of = (plus, minus) => held.has(plus) - held.has(minus);
  const [x, up, z] = [of('KeyD', 'KeyA'), of('KeyE', 'KeyQ'), of('KeyW', 'KeyS')];
  if (!x && !up && !z) return false;
  const speed = seconds * (held.has('Shift') ? 2 : 0.5) * (scene.reach ?? 1);
  carry(add(add(add([0, 0, 0], view.rows[0], x * speed), scene.up, up * speed), view.rows[2], z * speed));
  return true;
}

const actions = {
  ArrowLeft: () => show(current - 1),
  ArrowRight: () => show(current + 1),
  KeyR: () => show(current),
  KeyC: () => {
    if (!scene.cameras[current].photo) return;
    comparing = !photoShown();
    if (comparing && moved) show(current);
  },
  KeyF: () => { looking = !looking; },
  KeyH: () => toggleHelp($('help').hidden),
  Escape: () => toggleHelp(false),
};

function act(code) {
  actions[code]();
  remember();
}

function listen() {
  const pointers = new Map();
  canvas.addEventListener('contextmenu', (e) => e.preventDefault());
  canvas.addEventListener('pointerdown', (e) => {
    canvas.setPointerCapture(e.pointerId);
    canvas.focus();
    pointers.set(e.pointerId, [e.clientX, e.clientY]);
  });
  const away = (e) => pointers.delete(e.pointerId);
  canvas.addEventListener('pointerup', away);
  canvas.addEventListener('pointercancel', away);
  canvas.addEventListener('pointermove', (e) => {
    const before = pointers.get(e.pointerId);
    if (!before) return;
    const now = [e.clientX, e.clientY], [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    if (pointers.size === 1) {
      if (e.shiftKey || e.buttons & 6) shift(dx, dy); else turn(dx, dy);
    } else {
      const other = [...pointers].find(([id]) => id !== e.pointerId)[1];
      const span = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
      approach(span(before) / span(now));
      shift(dx / 2, dy / 2);
    }
    pointers.set(e.pointerId, now);
  });
  canvas.addEventListener('wheel', (e) => {
    e.preventDefault();
    approach(Math.exp(Math.max(-100, Math.min(100, e.deltaY * (e.deltaMode ? 33 : 1))) * 0.0015));
  }, { passive: false });
  canvas.addEventListener('dblclick', (e) => aim(e.clientX, e.clientY));
  const slide = (e) => {
    const box = $('photo').getBoundingClientRect();
    if (e.type === 'pointerdown') $('photo').setPointerCapture(e.pointerId);
    if (e.type === 'pointermove' && !e.buttons) return;
    split = Math.max(0, Math.min(1, (e.clientX - box.left) / box.width));
    frame();
  };
  $('photo').addEventListener('pointerdown', slide);
  $('photo').addEventListener('pointermove', slide);
  addEventListener('keydown', (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey || e.target.tagName === 'SELECT') return;
    if (e.key === 'Shift') held.add('Shift');
    if (/^Key[WASDQE]$/.test(e.code)) held.add(e.code);
    if (actions[e.code]) act(e.code);
    frame();
  });
  addEventListener('keyup', (e) => held.delete(e.key === 'Shift' ? 'Shift' : e.code));
  addEventListener('blur', () => held.clear());
  for (const [id, key] of [['previous', 'ArrowLeft'], ['next', 'ArrowRight'], ['compare', 'KeyC'], ['mode', 'KeyF'], ['helper', 'KeyH']]) {
    $(id).addEventListener('click', () => { act(key); frame(); });
  }
  $('cameras').addEventListener('change', (e) => { show(Number(e.target.value)); remember(); canvas.focus(); });
  addEventListener('resize', frame);
  addEventListener('hashchange', follow);
}

function toggleHelp(on) {
  $('help').hidden = !on;
  $('helper').setAttribute('aria-expanded', on);
}

// The camera that the address asks for by number or name, else the one to begin with.
function asked() {
  const wanted = hash().get('view'), at = scene.cameras.findIndex((c) => c.name === wanted);
  return at >= 0 ? at : /^\d+$/.test(wanted) ? Number(wanted) : scene.start;
}

// Shows what the address asks for.
function follow() {
  document.body.classList.toggle('bare', hash().has('bare'));
  comparing = hash().has('photo');
  show(asked());
}

function begin() {
  for (const [label, held_out] of [['held-out', true], ['training', false]]) {
    const group = document.createElement('optgroup');
    group.label = label;
    scene.cameras.forEach((c, k) => { if (c.held_out === held_out) group.append(new Option(c.name, k)); });
    if (group.children.length) $('cameras').append(group);
  }
  for (const remark of scene.remarks) $('remarks').append(Object.assign(document.createElement('p'), { textContent: remark }));
  $('notice').textContent = scene.remarks[0] ?? '';
  $('notice').hidden = !scene.remarks.length;
  listen();
  follow();
}
