// The page of a scene that the program renders: a picture for every movement, one at a time, and what there is to know of a run.
const near = scene.near, paper = canvas.getContext('2d');
let run = null, busy = false, stale = false, took = 0, last = 0;
const shown = { url: '', at: 0, iteration: -1 };

// The address of something of the server: values are numbers, lists of them and words, in which nothing is to be escaped.
const address = (path, values) => `${path}?` + Object.entries({ token: scene.token, ...values }).map((pair) => pair.join('=')).join('&');

async function get(path, values, options) {
  const answer = await fetch(address(path, values), { cache: 'no-store', ...options });
  if (!answer.ok) throw new Error((await answer.text()).trim());
  return answer;
}

function trouble(error) {
  const lost = error instanceof TypeError;
  $('notice').textContent = lost ? 'No answer: the program has ended, or the tunnel to it is closed.' : error?.message ?? '';
  $('notice').hidden = !error;
}

// The camera as the server reads it, on a canvas of this size.
function spelt(width, height) {
  const l = lens(width, height);
  return { width, height, lens: [l.fx, l.fy, l.cx, l.cy], rotation: view.rows.flat(), center: view.center };
}

const asError = () => $('shown').value === 'error' && !moved && Boolean(scene.cameras[current].photo);

// The picture that the page wants now: its address, the size of the canvas, and the part of it that the picture takes.
function question() {
  const size = hash().get('size')?.match(/^(\d{1,4})x(\d{1,4})$/), ratio = size ? 1 : Math.min(devicePixelRatio || 1, 2);
  const css = size ? [+size[1], +size[2]] : [innerWidth, innerHeight];
  // Training has little time for pictures.
  const most = scene.training && run?.state !== 'paused' && !size ? Math.min(640, scene.largest) : scene.largest;
  const k = Math.min(ratio * coarse, most / Math.max(...css));
  const [width, height] = css.map((v) => Math.max(1, Math.round(v * k)));
  const part = { left: 0, top: 0, width, height };
  if (!asError()) {
    const mode = $('shown').value === 'error' ? 'color' : $('shown').value;
    return { url: address('frame', { mode, ...spelt(width, height) }), css, sized: size, width, height, part };
  }
  const l = lens(width, height);
  Object.assign(part, { left: l.left, top: l.top, width: Math.max(1, Math.round(l.width)), height: Math.max(1, Math.round(l.height)) });
  const asked = { mode: 'error', view: current, width: part.width, height: part.height };
  return { url: address('frame', asked), css, sized: size, width, height, part };
}

// Asks for the picture if it is another one than the last; what is wanted meanwhile is asked for afterwards.
async function pull() {
  const wanted = question();
  if (busy || (wanted.url === shown.url && !stale)) return;
  busy = true;
  stale = false;
  const began = performance.now(), iteration = run?.iteration ?? -1;
  try {
    const answer = await fetch(wanted.url, { cache: 'no-store' });
    if (!answer.ok) throw new Error((await answer.text()).trim());
    const picture = await createImageBitmap(await answer.blob());
    [canvas.width, canvas.height] = [wanted.width, wanted.height];
    const { left, top, width, height } = wanted.part, [w, h] = wanted.css;
    Object.assign(canvas.style, { width: wanted.sized ? w + 'px' : '', height: wanted.sized ? h + 'px' : '' });
    paper.drawImage(picture, left, top, width, height);
    picture.close();
    took = performance.now() - began;
    trouble(null);
  } catch (error) {
    trouble(error);
    setTimeout(() => { stale = true; frame(); }, 2000);
  }
  Object.assign(shown, { url: wanted.url, at: performance.now(), iteration });
  busy = false;
  frame();
}

function step(now) {
  waiting = false;
  const flying = fly(Math.min((now - last) / 1000, 0.1));
  last = now;
  if (moving && took > 120) coarse = 0.5;
  pull();
  placePhoto(question().css);
  tell();
  if (flying) frame();
}

function tell() {
  const count = run?.gaussians ?? scene.gaussians;
  $('counts').textContent = `${number(count)} Gaussians · ${took.toFixed(0)} ms a picture`;
  tellView();
  const known = Boolean(scene.cameras[current].photo);
  $('shown').options[2].disabled = !known;
  $('shown').options[2].textContent = known && moved ? 'Error (R)' : 'Error';
}

function arrive() {}

// The pivot goes to what is under a pixel: as far as it was, and once the server knows better, as far as that.
async function aim(x, y) {
  const l = lens(innerWidth, innerHeight), [center, rows] = [view.center, view.rows];
  const along = (depth) => {
    const right = add(center, rows[0], ((x - l.cx) / l.fx) * depth);
    return add(add(right, rows[1], ((y - l.cy) / l.fy) * depth), rows[2], depth);
  };
  view.pivot = along(scene.reach);
  // Who moves on asks again where it comes to rest.
  await new Promise((rested) => setTimeout(rested, 250));
  if (view.center !== center || view.rows !== rows) return;
  const small = [innerWidth, innerHeight].map((v) => Math.max(1, Math.round(v / 4)));
  try {
    const at = [(x * small[0]) / innerWidth, (y * small[1]) / innerHeight];
    const { depth } = await (await get('depth', { ...spelt(...small), at })).json();
    if (depth && view.center === center && view.rows === rows) view.pivot = along(depth);
  } catch { /* the pictures tell that nobody answers */ }
}

// The run: its state and its curves.
const curves = { loss: [], psnr: [], gaussians: [] };
const digits = { loss: (v) => v.toFixed(4), psnr: (v) => v.toFixed(2) + ' dB', gaussians: number };
const named = { loss: 'loss', psnr: 'held-out PSNR', gaussians: 'Gaussians' };

function plot() {
  for (const [name, points] of Object.entries(curves)) {
    const box = $('curve-' + name), values = points.map((p) => p[1]);
    const [low, high] = [Math.min(...values), Math.max(...values)];
    box.querySelector('b').textContent = points.length ? digits[name](values.at(-1)) : '–';
    // From the beginning to now: of a run that is young the planned end is far away. A single value is a dot.
    const at = ([i, v]) => `${(100 * i) / Math.max(1, run.iteration, i)},${40 - (36 * (v - low)) / (high - low || 1)}`;
    const line = points.length === 1 ? [points[0], points[0]] : points;
    box.querySelector('polyline').setAttribute('points', line.map(at).join(' '));
  }
}

const drawn = (name) => document.createElementNS('http://www.w3.org/2000/svg', name);
function lay() {
  $('run').hidden = false;
  $('run').open = innerWidth > 760 && innerHeight > 480;
  for (const name of Object.keys(curves)) {
    const box = Object.assign(document.createElement('div'), { id: 'curve-' + name });
    const words = document.createElement('p'), [svg, line] = ['svg', 'polyline'].map(drawn);
    words.append(named[name], document.createElement('b'));
    svg.setAttribute('viewBox', '0 0 100 44');
    svg.setAttribute('preserveAspectRatio', 'none');
    svg.append(line);
    box.append(words, svg);
    $('curves').append(box);
  }
}

async function look() {
  try {
    const since = Math.max(-1, ...Object.values(curves).map((points) => points.at(-1)?.[0] ?? -1));
    run = await (await get('status', since < 0 ? {} : { since })).json();
    for (const [name, points] of Object.entries(run.points)) curves[name].push(...points);
    const share = `${number(run.iteration)} of ${number(run.iterations)}`;
    const left = run.state === 'training' && run.left !== null ? ` · ${Math.ceil(run.left / 60)} min left` : '';
    $('state').textContent = `${run.state} · ${share}${left}`;
    $('pause').textContent = run.state === 'paused' ? 'Continue' : 'Pause';
    $('saved').textContent = run.saved === null ? 'no checkpoint yet' : `checkpoint: ${number(run.saved)} iterations`;
    for (const id of ['pause', 'checkpoint', 'stop']) $(id).disabled = ['ending', 'stopping'].includes(run.state);
    plot();
    if (run.iteration !== shown.iteration && performance.now() - shown.at > 2000) stale = true;
    frame();
  } catch (error) {
    trouble(error);
  }
}

async function wish(name) {
  try {
    await get(name, {}, { method: 'POST' });
    await look();
  } catch (error) {
    trouble(error);
  }
}

function prepare() {
  const modes = [...$('shown').options].map((o) => o.value);
  actions.KeyM = () => {
    let next = modes.indexOf($('shown').value);
    do next = (next + 1) % modes.length; while ($('shown').options[next].disabled);
    $('shown').value = modes[next];
  };
  const mode = hash().get('mode');
  if (modes.includes(mode)) $('shown').value = mode;
  $('shown').addEventListener('change', () => { canvas.focus(); remember(); frame(); });
  if (!scene.training) return;
  lay();
  $('pause').addEventListener('click', () => wish(run?.state === 'paused' ? 'continue' : 'pause'));
  $('checkpoint').addEventListener('click', () => wish('checkpoint'));
  $('stop').addEventListener('click', () => { if (confirm('End the run here? It is saved, and can be resumed.')) wish('stop'); });
  look();
  setInterval(() => { if (!document.hidden) look(); }, 1000);
}

prepare();
begin();
