// The viewer of a scene page. No dependency, no network: shaders, scene and cameras are elements of the page.
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

// The scene: planes of numbers, each chunk of a plane as integers of one to three bytes between its least and its largest value.
function unpack() {
  const text = atob($('data').textContent.trim());
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  $('data').textContent = '';
  const { count, chunk, widths } = scene.packed, chunks = Math.ceil(count / chunk);
  const ranges = new Float32Array(bytes.buffer, 0, 2 * chunks * widths.length);
  let at = ranges.byteLength;
  return widths.map((width, plane) => {
    const out = new Float32Array(count), levels = 2 ** (8 * width) - 1;
    for (let c = 0; c < chunks; c++) {
      const low = ranges[2 * (plane * chunks + c)], high = ranges[2 * (plane * chunks + c) + 1];
      const step = (high - low) / levels, end = Math.min((c + 1) * chunk, count);
      for (let i = c * chunk; i < end; i++, at += width) {
        let level = bytes[at];
        if (width > 1) level |= bytes[at + 1] << 8;
        if (width > 2) level |= bytes[at + 2] << 16;
        out[i] = low + step * level;
      }
    }
    return out;
  });
}

// Sorts by depth; also the body of the worker, so it uses nothing outside. Keys are the bits of positive floats, which rise with
// them; two passes of a counting sort, stable, over 16 bits each.
function sorter(x, y, z) {
  const n = x.length, [ids, other] = [new Uint32Array(n), new Uint32Array(n)];
  const depths = new Float32Array(n), keys = new Uint32Array(depths.buffer), counts = new Uint32Array(65536);
  const pass = (from, to, m, shift) => {
    counts.fill(0);
    for (let i = 0; i < m; i++) counts[(keys[from[i]] >>> shift) & 65535]++;
    for (let k = 0, sum = 0; k < 65536; k++) sum += counts[k], counts[k] = sum - counts[k];
    for (let i = 0; i < m; i++) to[counts[(keys[from[i]] >>> shift) & 65535]++] = from[i];
  };
  return ([a, b, c, t, near]) => {
    let m = 0;
    for (let i = 0; i < n; i++) {
      depths[i] = a * x[i] + b * y[i] + c * z[i] + t;
      if (depths[i] > near) ids[m++] = i;
    }
    pass(ids, other, m, 0);
    pass(other, ids, m, 16);
    return ids.slice(0, m);
  };
}

const planes = unpack(), count = scene.packed.count, positions = planes.slice(0, 3);
const sort = sorter(...positions), near = scene.constants.near;
const opacity = planes[10].map((l) => 1 / (1 + Math.exp(-l)));
const extent = new Float32Array(count); // geometric mean of the scales

// WebGL.
const canvas = $('canvas');
const gl = canvas.getContext('webgl2', { alpha: false, antialias: false, depth: false, powerPreference: 'high-performance' });
const programs = {};
let buffer, target, total = 0;

function program(name, vertex, fragment, defines) {
  const made = gl.createProgram();
  for (const [kind, id] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, '#version 300 es\n' + defines + $(id).textContent);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(id + ': ' + gl.getShaderInfoLog(shader));
  }
  gl.bindAttribLocation(made, 0, 'index');
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  const uniforms = {};
  for (let k = gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS) - 1; k >= 0; k--) {
    const { name } = gl.getActiveUniform(made, k);
    uniforms[name] = gl.getUniformLocation(made, name);
  }
  programs[name] = { made, uniforms };
}

// A texture of `texels` RGBA values each per Gaussian, row after row.
function table(slot, format, texels, fill) {
  const side = Math.min(4096, gl.getParameter(gl.MAX_TEXTURE_SIZE)), rows = Math.max(1, Math.ceil((count * texels) / side));
  const values = new Float32Array(side * rows * 4);
  for (let i = 0; i < count; i++) fill(values, 4 * texels * i, i);
  texture(slot);
  gl.texImage2D(gl.TEXTURE_2D, 0, format, side, rows, 0, gl.RGBA, gl.FLOAT, values);
}

function texture(slot) {
  const made = gl.createTexture();
  gl.activeTexture(gl.TEXTURE0 + slot);
  gl.bindTexture(gl.TEXTURE_2D, made);
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
  for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
  return made;
}

function start() {
  const degree = scene.packed.degree, coefs = (degree + 1) ** 2, texels = Math.ceil((3 * coefs) / 4), k = scene.constants;
  const float = (v) => Number(v).toExponential(9);
  const names = { NEAR: k.near, BLUR: k.blur, ALPHA_MAX: k.alpha_max, LOG2_ALPHA_MIN: Math.log2(k.alpha_min), COLOR_MAX: k.color_max };
  const defines = `#define SH_DEGREE ${degree}\n#define SH_COUNT ${coefs}\n#define SH_TEXELS ${texels}\n#define ANTI_ALIAS ${
    Number(scene.anti_aliased)}\n` + Object.entries(names).map(([name, v]) => `#define ${name} (${float(v)})\n`).join('');
  program('splat', 'splat.vert', 'splat.frag', defines);
  program('show', 'show.vert', 'show.frag', '');
  table(0, gl.RGBA32F, 3, (out, at, i) => {
    for (let p = 0; p < 3; p++) out[at + p] = planes[p][i], out[at + 4 + p] = Math.exp(planes[3 + p][i]);
    extent[i] = Math.cbrt(out[at + 4] * out[at + 5] * out[at + 6]);
    const l = planes[10][i]; // log2 of the logistic function, without overflow
    out[at + 3] = -Math.LOG2E * (Math.max(-l, 0) + Math.log1p(Math.exp(-Math.abs(l))));
    const q = [6, 7, 8, 9].map((p) => planes[p][i]), norm = Math.hypot(...q);
    for (let p = 0; p < 4; p++) out[at + 8 + p] = norm > 0 ? q[p] / norm : Number(p === 0);
  });
  table(1, gl.RGBA16F, texels, (out, at, i) => {
    for (let p = 11; p < planes.length; p++) out[at + p - 11] = planes[p][i];
  });
  const float32 = gl.getExtension('EXT_color_buffer_float') && gl.getExtension('EXT_float_blend') && hash().has('float');
  const half = gl.getExtension('EXT_color_buffer_float') || gl.getExtension('EXT_color_buffer_half_float');
  target = { texture: texture(2), frame: gl.createFramebuffer(), format: float32 ? gl.RGBA32F : half ? gl.RGBA16F : gl.RGBA8 };
  target.type = float32 ? gl.FLOAT : half ? gl.HALF_FLOAT : gl.UNSIGNED_BYTE;
  if (!half) scene.remarks.push('This device blends colours in 8 bits: the picture is coarser than it is elsewhere.');
  buffer = gl.createBuffer();
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.disable(gl.DEPTH_TEST);
  planes.length = 3; // the rest is on the device now
}

function resize(width, height) {
  if (canvas.width === width && canvas.height === height && target.sized) return;
  [canvas.width, canvas.height, target.sized] = [width, height, true];
  gl.activeTexture(gl.TEXTURE2);
  gl.bindTexture(gl.TEXTURE_2D, target.texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, target.format, width, height, 0, gl.RGBA, target.type, null);
  gl.bindFramebuffer(gl.FRAMEBUFFER, target.frame);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target.texture, 0);
}

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

function draw() {
  const size = hash().get('size')?.match(/^(\d{1,4})x(\d{1,4})$/), ratio = size ? 1 : Math.min(devicePixelRatio || 1, 2);
  const css = size ? [+size[1], +size[2]] : [innerWidth, innerHeight];
  Object.assign(canvas.style, { width: size ? css[0] + 'px' : '', height: size ? css[1] + 'px' : '' });
  const [width, height] = css.map((v) => Math.max(1, Math.round(v * ratio * coarse)));
  resize(width, height);
  const l = lens(width, height), mx = (0.3 * width) / (2 * l.fx), my = (0.3 * height) / (2 * l.fy);
  gl.bindFramebuffer(gl.FRAMEBUFFER, target.frame);
  gl.viewport(0, 0, width, height);
  gl.clearColor(0, 0, 0, 1);
  gl.clear(gl.COLOR_BUFFER_BIT);
  gl.enable(gl.BLEND);
  gl.blendFuncSeparate(gl.DST_ALPHA, gl.ONE, gl.ZERO, gl.ONE_MINUS_SRC_ALPHA);
  let { made, uniforms: u } = programs.splat;
  gl.useProgram(made);
  gl.uniform1i(u.geometry, 0);
  gl.uniform1i(u.coefficients, 1);
  view.rows.forEach((row, k) => gl.uniform3fv(u['row' + k], row));
  gl.uniform3fv(u.translation, translation());
  gl.uniform3fv(u.center, view.center);
  gl.uniform4f(u.lens, l.fx, l.fy, l.cx, l.cy);
  gl.uniform4f(u.limits, -l.cx / l.fx - mx, (width - l.cx) / l.fx + mx, -l.cy / l.fy - my, (height - l.cy) / l.fy + my);
  gl.uniform2f(u.size, width, height);
  gl.enableVertexAttribArray(0);
  gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
  gl.vertexAttribDivisor(0, 1);
  if (total) gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, total);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.disable(gl.BLEND);
  gl.disableVertexAttribArray(0);
  ({ made, uniforms: u } = programs.show);
  gl.useProgram(made);
  gl.uniform1i(u.composited, 2);
  gl.uniform3fv(u.background, scene.background);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  placePhoto(css);
}

// Sorting: at once where the camera jumps, in a worker while it moves.
let worker = null, busy = null, sorted = null;
try {
  const code = `${sorter}\nlet sort;onmessage = ({data}) => {if (!sort) sort = sorter(...data); else {const ids = sort(data);` +
    'postMessage(ids, [ids.buffer]);}};';
  worker = new Worker(URL.createObjectURL(new Blob([code], { type: 'text/javascript' })));
  worker.onerror = () => { [worker, busy, sorted] = [null, null, null]; frame(); };
  worker.onmessage = ({ data }) => {
    if (busy === sorted) use(data); // else the camera has jumped meanwhile
    busy = null;
    frame();
  };
  worker.postMessage(positions);
} catch { worker = null; }

function use(ids) {
  total = ids.length;
  gl.bufferData(gl.ARRAY_BUFFER, ids, gl.DYNAMIC_DRAW);
}

const depthRow = () => [...view.rows[2], translation()[2], near];

function sortNow() {
  sorted = depthRow();
  use(sort(sorted));
}

function sortLater() {
  const row = depthRow();
  if (sorted && row.every((v, k) => v === sorted[k])) return;
  if (!worker) return sortNow();
  if (busy) return;
  busy = sorted = row;
  worker.postMessage(row);
}

// Frames: only when something has changed.
let waiting = false, last = 0, rate = 0, moving = 0;
function frame() {
  if (!waiting) requestAnimationFrame(step);
  waiting = true;
}

function step(now) {
  waiting = false;
  const seconds = (now - last) / 1000;
  last = now;
  if (moving && seconds > 0 && seconds < 0.5) rate = rate ? 0.9 * rate + 0.1 / seconds : 1 / seconds;
  const flying = fly(Math.min(seconds, 0.1));
  if (moving && rate && rate < 15) coarse = 0.5;
  sortLater();
  draw();
  tell();
  if (flying) frame();
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
function tell() {
  const left = scene.gaussians > count ? ` of ${number(scene.gaussians)}` : '';
  $('counts').textContent = `${number(count)}${left} Gaussians · ${rate ? rate.toFixed(0) : '–'} fps`;
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
  if ($('picture').src !== camera.photo) $('picture').src = camera.photo;
  const l = lens(width, height);
  Object.assign($('photo').style, { left: l.left + 'px', top: l.top + 'px', width: l.width + 'px', height: l.height + 'px' });
  $('picture').style.clipPath = `inset(0 ${100 * (1 - split)}% 0 0)`;
  $('split').style.left = 100 * split + '%';
}

// The point of the scene under a pixel of the canvas: where the Gaussians there, front to back, hide half of what is behind.
function pick(x, y) {
  const l = lens(innerWidth, innerHeight), t = translation(), radius = 0.04 * Math.min(innerWidth, innerHeight), found = [];
  for (let i = 0; i < count; i++) {
    const p = [positions[0][i], positions[1][i], positions[2][i]], z = dot(view.rows[2], p) + t[2];
    if (!(z > near)) continue;
    const dx = (l.fx * (dot(view.rows[0], p) + t[0])) / z + l.cx - x, dy = (l.fy * (dot(view.rows[1], p) + t[1])) / z + l.cy - y;
    if (dx * dx + dy * dy > radius * radius) continue;
    found.push([z, opacity[i] * Math.min(1, ((l.fx * extent[i]) / z / radius) ** 2)]);
  }
  found.sort((a, b) => a[0] - b[0]);
  let clear = 1, depth = found.length ? found[found.length >> 1][0] : 1;
  for (const [z, cover] of found) {
    clear *= 1 - cover;
    if (clear < 0.5) { depth = z; break; }
  }
  const [u, v] = [(x - l.cx) / l.fx, (y - l.cy) / l.fy];
  return add(add(add(view.center, view.rows[0], u * depth), view.rows[1], v * depth), view.rows[2], depth);
}

function show(k) {
  const n = scene.cameras.length, camera = scene.cameras[(current = ((k % n) + n) % n)];
  const r = camera.rotation;
  view.rows = [r.slice(0, 3), r.slice(3, 6), r.slice(6, 9)];
  view.center = camera.center;
  view.lens = camera;
  moved = false;
  $('cameras').value = current;
  if (hash().has('worker')) sortLater(); else sortNow();
  view.pivot = pick(innerWidth / 2, innerHeight / 2);
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
  const speed = seconds * (held.has('Shift') ? 2 : 0.5);
  carry(add(add(add([0, 0, 0], view.rows[0], x * speed), scene.up, up * speed), view.rows[2], z * speed));
  return true;
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
  canvas.addEventListener('dblclick', (e) => { view.pivot = pick(e.clientX, e.clientY); });
  const slide = (e) => {
    const box = $('photo').getBoundingClientRect();
    if (e.type === 'pointerdown') $('photo').setPointerCapture(e.pointerId);
    if (e.type === 'pointermove' && !e.buttons) return;
    split = Math.max(0, Math.min(1, (e.clientX - box.left) / box.width));
    frame();
  };
  $('photo').addEventListener('pointerdown', slide);
  $('photo').addEventListener('pointermove', slide);
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
  addEventListener('keydown', (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey || e.target === $('cameras')) return;
    if (e.key === 'Shift') held.add('Shift');
    if (/^Key[WASDQE]$/.test(e.code)) held.add(e.code);
    if (actions[e.code]) actions[e.code]();
    frame();
  });
  addEventListener('keyup', (e) => held.delete(e.key === 'Shift' ? 'Shift' : e.code));
  addEventListener('blur', () => held.clear());
  for (const [id, key] of [['previous', 'ArrowLeft'], ['next', 'ArrowRight'], ['compare', 'KeyC'], ['mode', 'KeyF'], ['helper', 'KeyH']]) {
    $(id).addEventListener('click', () => { actions[key](); frame(); });
  }
  $('cameras').addEventListener('change', (e) => { show(Number(e.target.value)); canvas.focus(); });
  addEventListener('resize', frame);
  addEventListener('hashchange', follow);
  canvas.addEventListener('webglcontextlost', () => say('The graphics device was reset. Load the page again.'));
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

if (!gl) {
  say('This browser draws without WebGL2, which the scene needs: switch hardware acceleration on, or use a newer browser. ' +
    'scene.ply beside this page opens in other viewers, and `mhsplat render` draws it without any.');
} else {
  try {
    start();
    begin();
  } catch (error) {
    say(`The scene cannot be drawn here: ${error.message}`);
    throw error;
  }
}
