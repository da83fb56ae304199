// The viewer of a scene page. No dependency, no network: shaders, scene and cameras are elements of the page.
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

let last = 0, rate = 0;
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

// Words.
function tell() {
  const left = scene.gaussians > count ? ` of ${number(scene.gaussians)}` : '';
  $('counts').textContent = `${number(count)}${left} Gaussians · ${rate ? rate.toFixed(0) : '–'} fps`;
  tellView();
}

function arrive() {
  if (hash().has('worker')) sortLater(); else sortNow();
}

function aim(x, y) {
  view.pivot = pick(x, y);
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

if (!gl) {
  say('This browser draws without WebGL2, which the scene needs: switch hardware acceleration on, or use a newer browser. ' +
    'scene.ply beside this page opens in other viewers, and `mhsplat render` draws it without any.');
} else {
  try {
    canvas.addEventListener('webglcontextlost', () => say('The graphics device was reset. Load the page again.'));
    start();
    begin();
  } catch (error) {
    say(`The scene cannot be drawn here: ${error.message}`);
    throw error;
  }
}
