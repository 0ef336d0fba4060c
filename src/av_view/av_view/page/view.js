// The page: shows what the server sends, and asks it for the next update when the previous one is shown.
'use strict';

const WINDOW_S = 60, TAIL_S = 15, RIM = 84, RETRY_MS = 1000;
const STATE_WORDS = { none: 'no target', sight: 'by sight', sound: 'by sound', coasting: 'predicted' };
const [TIME, SOUND, MIRROR, SIGHT, FUSED, SIGMA, TRUTH, SOUND_CONFIDENCE, SIGHT_CONFIDENCE, STATE, DELAY, SNR] = Array(12).keys(), DELAY_MS = 12;
const $ = id => document.getElementById(id);
const color = name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const token = location.hash.slice(1) || sessionStorage.getItem('token') || '';
if (location.hash) { sessionStorage.setItem('token', token); history.replaceState(null, '', location.pathname); }

let socket, pending, bagsAsked = -Infinity, number = 0, rig = null, rows = [], arrived = null, state = null, nodes = [], offers = [], control = false, northUp = false, pictureTime = 0;
let pictureUrl = '';
const answers = new Map(), tails = new Map(), mapTails = new Map();

function connect() {
  socket = new WebSocket(`ws://${location.host}/feed`);
  socket.binaryType = 'blob';
  socket.onopen = () => ask('watch', rig === null ? {} : { rig });
  socket.onmessage = event => typeof event.data === 'string' ? take(JSON.parse(event.data)) : showPicture(event.data);
  socket.onclose = () => { lost(); setTimeout(connect, RETRY_MS); };
}

function ask(action, values = {}) { socket.send(JSON.stringify({ do: action, ...values })); }

// A request that needs the token; resolves to the answer.
function request(action, values) {
  return new Promise(resolve => { answers.set(++number, resolve); ask(action, { ...values, number, token }); });
}

function take(message) {
  if (message.type === 'state') {
    if (rows.length && message.rows[0][TIME] < rows[rows.length - 1][TIME]) rows = []; // a replay that began again
    rows.push(...message.rows);
    while (rows[0][TIME] < rows[rows.length - 1][TIME] - WINDOW_S) rows.shift();
    arrived = message.state;
  } else if (message.type === 'health') {
    ({ nodes, offers } = message); showHealth(); showPointing();
  } else if (message.type === 'rigs') {
    control = message.control; rig ??= message.rig; showRigs(message.rigs);
  } else if (message.type === 'answer') {
    answers.get(message.number)?.(message); answers.delete(message.number);
  } else if (message.type === 'end') {
    requestAnimationFrame(() => { state = arrived; if (state) show(); if (socket.readyState === 1) ask('next'); });
  }
}

function lost() {
  for (const resolve of answers.values()) resolve({ done: false, words: 'the connection was lost' });
  answers.clear(); rows = []; arrived = state = null;
  $('state').textContent = 'no connection'; $('state').className = 'chip lost'; $('bearing').value = '';
  $('reason').textContent = 'The rig does not answer; trying again.';
}

function showPicture(blob) {
  const old = pictureUrl;
  pictureUrl = $('picture').src = URL.createObjectURL(blob);
  $('picture').hidden = false; $('no-picture').hidden = true; pictureTime = performance.now();
  if (old) URL.revokeObjectURL(old);
}

function show() {
  const { bearing, fusion } = state, known = bearing && bearing.state !== 'none';
  $('state').textContent = bearing ? STATE_WORDS[bearing.state] : 'no bearing';
  $('state').className = `chip ${bearing ? bearing.state : ''}`;
  $('bearing').value = known ? `${signed(bearing.azimuth)}° ± ${bearing.sigma ?? '?'}°${bearing.range ? `, ${Math.round(bearing.range)} m` : ''}` : '';
  $('reason').textContent = [fusion?.reason, known && !bearing.resolved ? 'front and back not resolved' : '',
    fusion?.missing.length ? `missing: ${fusion.missing.join(', ')}` : ''].filter(Boolean).join('; ');
  showOverlay(); showPolar(); showMap(); showAzimuths(); showConfidences(); showSnr(); showDelays(); showSpectrum(); showCommand();
}

const signed = value => (value > 0 ? '+' : '') + value.toFixed(1);

function element(parent, name, attributes, text) {
  const made = document.createElementNS('http://www.w3.org/2000/svg', name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return parent.appendChild(made);
}

function showOverlay() {
  const image = $('picture'), svg = $('overlay'), width = image.naturalWidth || 640, height = image.naturalHeight || 480;
  if (performance.now() - pictureTime > 2000) { image.hidden = true; $('no-picture').hidden = false; }
  image.parentElement.style.aspectRatio = `${width} / ${height}`;
  svg.setAttribute('viewBox', `0 0 ${width} ${height}`);
  svg.replaceChildren();
  const path = points => points.map(([x, y]) => `${x * width},${y * height}`).join(' ');
  const { bearing, sound, sight, tracks } = state;
  if (bearing?.band.length) element(svg, 'polygon', { class: 'band', points: path(bearing.band) });
  for (const group of sound?.groups ?? []) for (const image of group.images) if (image.line.length) element(svg, 'polyline', { class: 'heard', points: path(image.line) });
  if (bearing?.line.length) element(svg, 'polyline', { class: 'line', points: path(bearing.line) });
  if (bearing?.centre) element(svg, 'circle', { class: 'centre', cx: bearing.centre[0] * width, cy: bearing.centre[1] * height, r: 14 });
  for (const box of sight?.boxes ?? []) if (box.x !== undefined) {
    element(svg, 'rect', { class: 'box', x: box.x * width, y: box.y * height, width: box.width * width, height: box.height * height });
    element(svg, 'text', { x: box.x * width, y: Math.max(box.y * height - 5, 14) }, `${box.name} ${(box.score ?? 0).toFixed(2)}`);
  }
  for (const track of tracks) if (track.point) element(svg, 'text', { x: track.point[0] * width + 8, y: track.point[1] * height + 16 }, `#${track.id} ${track.name}`);
  $('picture-note').textContent = sight ? `${sight.boxes.length} ${sight.boxes.length === 1 ? 'detection' : 'detections'}, ${Math.round(1000 * sight.age)} ms old` : 'no detections';
}

// Position on the polar view of an azimuth in degrees (counter-clockwise from ahead) at a radius.
function at(azimuth, radius) {
  const turn = (northUp ? azimuth + (state.heading ?? 0) - 90 : azimuth) * Math.PI / 180;
  return [-radius * Math.sin(turn), -radius * Math.cos(turn)];
}

const points = places => places.map(place => place.map(value => value.toFixed(1)).join(',')).join(' ');

function wedge(from, to, inner, outer) {
  const steps = Math.max(2, Math.ceil(Math.abs(to - from) / 4)), edge = radius => Array.from({ length: steps + 1 }, (_, i) => at(from + (to - from) * i / steps, radius));
  return points([...edge(outer), ...edge(inner).reverse()]);
}

function spoke(svg, kind, azimuth, from, to, opacity = 1) {
  const [x1, y1] = at(azimuth, from), [x2, y2] = at(azimuth, to);
  element(svg, 'line', { class: kind, x1, y1, x2, y2, opacity });
}

function showPolar() {
  const svg = $('polar'), { bearing, camera, sound, sight, truth, tracks, heading, posterior } = state, bins = posterior.length;
  svg.replaceChildren();
  for (const radius of [RIM / 2, RIM]) element(svg, 'circle', { class: 'rim', r: radius });
  const marks = northUp ? { E: 0, N: 90, W: 180, S: -90 } : { ahead: 0, left: 90, behind: 180, right: -90 };
  for (const [name, azimuth] of Object.entries(marks)) {
    const [x, y] = at(northUp ? azimuth - (heading ?? 0) : azimuth, RIM + 27);
    element(svg, 'text', { x, y: y + 3, 'text-anchor': 'middle' }, name);
  }
  if (camera) element(svg, 'polygon', { class: 'view', points: wedge(camera.azimuth - camera.view / 2, camera.azimuth + camera.view / 2, 6, RIM) });
  const ring = height => posterior.map((value, i) => at(-180 + (i + 0.5) * 360 / bins, RIM + 1 + height * value));
  if (bins) element(svg, 'polygon', { class: 'ring', points: points([...ring(18), ...ring(0).reverse()]) });
  if (bearing && bearing.state !== 'none') {
    const sigma = Math.min(bearing.sigma ?? 180, 180);
    element(svg, 'polygon', { class: 'sigma', points: wedge(bearing.azimuth - sigma, bearing.azimuth + sigma, 6, RIM) });
  }
  for (const group of sound?.groups ?? []) for (const image of group.images) spoke(svg, 'image', image.azimuth, 8, RIM, imageOpacity(image.azimuth, group));
  for (const box of sight?.boxes ?? []) if (box.azimuth !== null) spoke(svg, 'line stroke-sight', box.azimuth, RIM - 16, RIM);
  for (const target of truth) { const [cx, cy] = at(target.azimuth, RIM - 8); element(svg, 'circle', { class: 'true', cx, cy, r: 5 }); }
  if (bearing && bearing.state !== 'none') spoke(svg, 'line stroke-fused', bearing.azimuth, 8, RIM);
  showTracks(svg, tracks);
  const [[x1, y1], [x2, y2], [x3, y3]] = [at(0, 9), at(140, 7), at(-140, 7)];
  element(svg, 'polygon', { class: 'rig', points: `${x1},${y1} ${x2},${y2} ${x3},${y3}` });
}

// Mirror images fade as they are ruled out: the image at the bearing has its probability, the others the rest.
function imageOpacity(azimuth, group) {
  const { bearing } = state;
  if (!bearing || bearing.state === 'none' || group.images.length < 2) return 0.9;
  const near = Math.abs(difference(azimuth, bearing.azimuth)) < Math.min(...group.images.filter(one => one.azimuth !== azimuth).map(one => Math.abs(difference(one.azimuth, bearing.azimuth))));
  return Math.max(0.12, near ? bearing.probability : 1 - bearing.probability);
}

const difference = (a, b) => ((a - b + 540) % 360) - 180;

function showTracks(svg, tracks) {
  const level = track => RIM * (track.range ? Math.min(Math.log10(1 + track.range) / 3, 1) : 1);
  follow(tails, tracks, track => [track.azimuth_world ?? track.azimuth, level(track)]);
  for (const track of tracks) {
    const offset = track.azimuth_world === null ? 0 : track.azimuth - track.azimuth_world, [cx, cy] = at(track.azimuth, level(track));
    element(svg, 'polyline', { class: 'tail', points: points(tails.get(track.id).map(([, azimuth, radius]) => at(azimuth + offset, radius))) });
    element(svg, 'circle', { class: `track ${track.selected ? 'selected' : ''}`, cx, cy, r: 3.5 });
    element(svg, 'text', { class: 'name', x: cx + 6, y: cy + 3 }, `#${track.id} ${track.name}${track.range ? ` ${Math.round(track.range)} m` : ''}`);
  }
}

// Keep where each track was in the last seconds; those that have ended are forgotten.
function follow(kept, tracks, place) {
  for (const id of kept.keys()) if (!tracks.some(track => track.id === id)) kept.delete(id);
  for (const track of tracks) {
    const tail = (kept.get(track.id) ?? []).filter(([time]) => time >= state.time - TAIL_S && time < state.time);
    kept.set(track.id, [...tail, [state.time, ...place(track)]]);
  }
}

// Positions of rigs and targets in metres, north up, with ellipses of one standard deviation.
function showMap() {
  const svg = $('map'), { rigs, tracks } = state.world ?? { rigs: [], tracks: [] }, all = [...rigs, ...tracks];
  follow(mapTails, tracks, track => [track.x, track.y]);
  svg.replaceChildren(); $('map-box').hidden = !all.length;
  if (!all.length) return;
  const [low, high] = [Math.min, Math.max].map(bound => ['x', 'y'].map(axis => bound(...all.map(one => one[axis]))));
  const needed = Math.max(10, 0.65 * (high[0] - low[0]) * 9 / 16, 0.65 * (high[1] - low[1])), step = 10 ** Math.floor(Math.log10(needed));
  const half = step * [1, 2, 5, 10].find(one => one * step >= needed), scale = 90 / half, place = (x, y) => [(x - (low[0] + high[0]) / 2) * scale, ((low[1] + high[1]) / 2 - y) * scale];
  const text = (x, y, words) => element(svg, 'text', { x: x + 6, y: y + 3, class: 'name' }, words);
  for (const track of tracks) {
    const [cx, cy] = place(track.x, track.y), [long, short, angle] = track.ellipse;
    for (const rig of rigs) if (track.rigs.includes(rig.name)) { const [x1, y1] = place(rig.x, rig.y); element(svg, 'line', { class: 'sight-line', x1, y1, x2: cx, y2: cy }); }
    element(svg, 'polyline', { class: 'tail', points: points(mapTails.get(track.id).map(([, x, y]) => place(x, y))) });
    if (track.positioned) element(svg, 'ellipse', { class: 'sigma', cx, cy, rx: long * scale, ry: short * scale, transform: `rotate(${-angle} ${cx} ${cy})` });
    element(svg, 'circle', { class: `track ${track.positioned ? 'selected' : ''}`, cx, cy, r: 3 });
    text(cx, cy, `#${track.id} ${track.name}${track.positioned ? `, ${Math.round(track.z)} m up` : ', distance unknown'}`);
  }
  for (const rig of rigs) { const [x, y] = place(rig.x, rig.y); element(svg, 'rect', { class: 'rig', x: x - 3, y: y - 3, width: 6, height: 6 }); text(x, y, rig.name || 'rig'); }
  element(svg, 'line', { class: 'scale', x1: -150, x2: -150 + half * scale / 2, y1: 82, y2: 82 });
  element(svg, 'text', { x: -150, y: 78 }, `${half / 2} m`);
  $('map-note').textContent = `${tracks.length} ${tracks.length === 1 ? 'target' : 'targets'} by ${rigs.length} rigs, north is up`;
}

// A diagram of the last minute; returns its context and scales.
function diagram(id, low, high, lines) {
  const canvas = $(id), ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight, left = 34;
  if (canvas.width !== Math.round(width * ratio)) { canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio); }
  const context = canvas.getContext('2d'), end = rows.length ? rows[rows.length - 1][TIME] : 0;
  context.setTransform(ratio, 0, 0, ratio, 0, 0); context.clearRect(0, 0, width, height);
  const x = time => left + (width - left - 4) * (1 + (time - end) / WINDOW_S), y = value => 6 + (height - 12) * (high - value) / (high - low);
  context.font = '11px system-ui, sans-serif'; context.textAlign = 'right'; context.textBaseline = 'middle';
  for (const value of lines) {
    context.strokeStyle = color('line'); context.fillStyle = color('quiet'); context.lineWidth = 1;
    context.beginPath(); context.moveTo(left, y(value)); context.lineTo(width, y(value)); context.stroke();
    context.fillText(String(value), left - 5, y(value));
  }
  return { context, x, y, width, height, left };
}

function dots({ context, x, y }, column, name, size, alpha = 1) {
  context.fillStyle = color(name); context.globalAlpha = alpha;
  for (const row of rows) if (row[column] !== null) context.fillRect(x(row[TIME]) - size / 2, y(row[column]) - size / 2, size, size);
  context.globalAlpha = 1;
}

// A line that is broken where the value is unknown or jumps, as an azimuth does at 180 degrees.
function line({ context, x, y }, column, name, width, dash = [], jump = Infinity) {
  context.strokeStyle = color(name); context.lineWidth = width; context.setLineDash(dash); context.beginPath();
  let last = null;
  for (const row of rows) {
    const value = row[column];
    if (value !== null) last === null || Math.abs(value - last) > jump ? context.moveTo(x(row[TIME]), y(value)) : context.lineTo(x(row[TIME]), y(value));
    last = value;
  }
  context.stroke(); context.setLineDash([]);
}

function showAzimuths() {
  const scale = diagram('azimuths', -180, 180, [-180, -90, 0, 90, 180]), { context, x, y } = scale;
  context.fillStyle = color('fused'); context.globalAlpha = 0.2;
  for (const row of rows) if (row[FUSED] !== null && row[SIGMA] !== null) {
    const sigma = Math.min(row[SIGMA], 180);
    for (const turn of [-360, 0, 360]) context.fillRect(x(row[TIME]) - 1, y(row[FUSED] + sigma + turn), 2, y(0) - y(2 * sigma));
  }
  context.globalAlpha = 1;
  dots(scale, MIRROR, 'sound', 2.5, 0.35); dots(scale, SOUND, 'sound', 2.5, 0.8); dots(scale, SIGHT, 'sight', 3.5);
  line(scale, TRUTH, 'truth', 1.5, [5, 4], 180); line(scale, FUSED, 'fused', 2, [], 180);
  context.fillStyle = color('text'); context.textAlign = 'left';
  for (const [time, words] of state.marks) if (x(time) >= scale.left) { context.fillRect(x(time), 0, 1, scale.height); context.fillText(words, x(time) + 4, 12); }
}

function showConfidences() {
  const scale = diagram('confidences', -0.12, 1, [0, 0.5, 1]), { context, x, y } = scale;
  line(scale, SOUND_CONFIDENCE, 'sound', 1.5); line(scale, SIGHT_CONFIDENCE, 'sight', 1.5);
  for (const row of rows) if (row[STATE] !== 'none') { context.fillStyle = color(row[STATE]); context.fillRect(x(row[TIME]) - 1, y(-0.03), 2.5, 5); }
}

function showSnr() { line(diagram('snr', -20, 30, [-20, 0, 20]), SNR, 'sound', 1.5); }

function showDelays() {
  const most = Math.max(0.1, ...rows.map(row => row[DELAY] ?? 0)), top = most > 0.5 ? Math.ceil(most) * 1000 : Math.ceil(most * 10) * 100;
  rows.forEach(row => { row[DELAY_MS] = row[DELAY] === null ? null : 1000 * row[DELAY]; });
  line(diagram('delays', 0, top, [0, top / 2, top]), DELAY_MS, 'fused', 1.5);
}

function showSpectrum() {
  const { context, y, width, height, left } = diagram('spectrum', -100, 0, [-80, -40, 0]), bands = state.spectrum.length, step = (width - left) / Math.max(bands, 1);
  context.fillStyle = color('sound');
  state.spectrum.forEach((level, i) => { const top = y(Math.max(level, -100)); context.fillRect(left + i * step, top, Math.max(step - 1, 1), height - 6 - top); });
  context.fillStyle = color('quiet'); context.textAlign = 'center';
  for (const hertz of bands ? [100, 1000, 10000] : []) context.fillText(hertz < 1000 ? `${hertz} Hz` : `${hertz / 1000} kHz`, left + (width - left) * Math.log(hertz / 60) / Math.log(20000 / 60), 8);
}

const valueOf = (node, key) => nodes.find(one => one.node.endsWith(`/${node}`))?.values.find(([name]) => name === key)?.[1];

function showCommand() {
  const { command } = state;
  $('command').textContent = !command ? 'no commands' : `${command.mode}: ${command.reason}` +
    (command.pan === null ? '' : `; gimbal ${signed(command.pan)}°, ${signed(command.tilt)}°`) + (command.yaw_rate === null ? '' : `; body ${signed(command.yaw_rate)}°/s`);
}

function whatMoves() {
  const parts = [state?.command?.pan !== null ? 'the gimbal' : '', state?.command?.yaw_rate !== null ? 'the body of the rig' : ''].filter(Boolean);
  return state?.command ? parts.join(' and ') || 'nothing' : 'gimbal and body';
}

function showPointing() {
  const enabled = valueOf('pointing_node', 'enabled') === 'True';
  $('moves').textContent = enabled ? 'Commands move the rig.' : 'Commands move nothing.';
  $('enable').textContent = enabled ? 'Stop: commands shall move nothing' : 'Let commands move the rig…';
  $('enable').className = enabled ? 'danger' : '';
  const permitted = control && token, unresolved = state?.bearing && state.bearing.state !== 'none' && !state.bearing.resolved;
  for (const button of ['enable', 'turn', 'select', 'record', 'pause'].map($)) { button.disabled = !permitted; button.hidden = !offers.includes(button.id); }
  $('enable').hidden = false; $('enable').disabled ||= !offers.includes('enable');
  $('turn').disabled ||= !enabled || !unresolved;
  $('turn').title = !enabled ? 'Commands move nothing.' : unresolved ? '' : 'Front and back are told apart, or there is no target.';
  options('select', [[0, 'Follow a target by policy'], ...(state?.tracks ?? []).map(({ id, name }) => [id, `Follow #${id} ${name}`])]);
  $('mark').hidden = !permitted; $('open').hidden = $('pause').hidden || $('open').length < 2;
  if (permitted && !$('pause').hidden && performance.now() - bagsAsked > 10000) {
    bagsAsked = performance.now();
    request('bags', {}).then(({ bags }) => options('open', [['', 'Open a bag…'], ...(bags ?? []).map(name => [name, name])]));
  }
  if (!control || !token) $('answer').textContent = control ? 'Read-only: open the address with the token.' : 'Read-only. The rig is controlled here with view_control:=true.';
  const recording = nodes.some(one => one.node.endsWith('/recorder_node') && one.words !== 'not active');
  $('record').textContent = recording ? 'Stop recording' : 'Start recording'; $('record').value = recording ? '' : 'yes';
  const paused = valueOf('player_node', 'paused') === 'True';
  $('pause').textContent = paused ? 'Play' : 'Pause'; $('pause').value = paused ? '' : 'yes';
  const [position, length] = (valueOf('player_node', 'position') ?? '').split(' of ').map(parseFloat);
  $('seek-box').hidden = $('pause').hidden; $('seek').disabled = $('pause').disabled; $('seek').max = length || 0;
  if (document.activeElement !== $('seek')) $('seek').value = position || 0;
  $('position').value = valueOf('player_node', 'position') ?? '';
  $('parameters-box').hidden = !control || !token;
}

async function act(action, values) {
  $('answer').textContent = '…';
  const answer = await request(action, values);
  $('answer').textContent = (answer.done ? '' : 'Refused: ') + (answer.words || 'done');
}

$('enable').onclick = () => {
  if (valueOf('pointing_node', 'enabled') === 'True') { act('enable', { value: false }); return; }
  confirmMove(`From now on ${whatMoves()} will move by itself towards the bearing`, 'enable', { value: true });
};
$('turn').onclick = () => confirmMove('The body of the rig will turn until front and back are told apart, for 10 s at most', 'turn', {});
$('select').onchange = () => {
  const value = Number($('select').value), wanted = ['select', { value }];
  if (valueOf('pointing_node', 'enabled') !== 'True') act(...wanted);
  else confirmMove(`${whatMoves()} will move towards ${value ? `target #${value}` : 'the target that the policy chooses'}`, ...wanted);
};
$('open').onchange = () => { act('open', { value: $('open').value }); $('open').value = ''; };
$('mark').onsubmit = event => { event.preventDefault(); act('mark', { value: $('mark-text').value }); $('mark-text').value = ''; };

// Ask before something moves.
function confirmMove(words, ...wanted) {
  pending = wanted;
  $('ask-words').textContent = `${words}, within the limits of pointing_node. Is everybody clear of it?`;
  $('ask').showModal();
}
$('ask').onclose = () => { if ($('ask').returnValue === 'yes') act(...pending); $('ask').returnValue = ''; };
for (const id of ['record', 'pause']) $(id).onclick = () => act(id, { value: Boolean($(id).value) });
$('seek').onchange = () => { act('set', { node: `${rig}/player_node`, name: 'position', value: Number($('seek').value) }); $('seek').blur(); };
$('orientation').onclick = () => { northUp = !northUp; $('orientation').textContent = northUp ? 'north' : 'ahead'; };

function made(parent, name, text, kind = '') {
  const child = document.createElement(name);
  child.textContent = text; child.className = kind;
  return parent.appendChild(child);
}

function showHealth() {
  const open = new Set([...document.querySelectorAll('#health details[open]')].map(details => details.dataset.node));
  const worst = nodes.filter(node => node.level !== 'ok').length;
  $('health-note').textContent = nodes.length ? worst ? `${worst} of ${nodes.length} nodes need a look` : `all ${nodes.length} nodes are well` : 'no node reports';
  $('health').replaceChildren();
  for (const node of nodes) {
    const item = made($('health'), 'li', '', node.level), details = made(item, 'details', ''), summary = made(details, 'summary', '');
    details.dataset.node = node.node; details.open = open.has(node.node);
    made(summary, 'b', node.node.replace(/^\//, '')); summary.append(` ${node.words}`);
    const table = made(details, 'table', '');
    for (const [key, value] of node.values) { const row = made(table, 'tr', ''); made(row, 'td', key); made(row, 'td', value); }
    for (const advice of node.advice) made(item, 'p', advice, 'advice');
  }
  options('nodes', [['', ''], ...nodes.map(({ node }) => [node, node.slice(1)]).sort()]);
}

// Change what a list offers, and keep what is chosen.
function options(id, entries) {
  const list = $(id), offered = JSON.stringify(entries), chosen = list.value;
  if (list.dataset.offered === offered) return;
  list.dataset.offered = offered;
  list.replaceChildren(...entries.map(([value, text]) => new Option(text, value)));
  list.value = entries.some(([value]) => String(value) === chosen) ? chosen : entries[0]?.[0];
}

$('nodes').onchange = async () => {
  const node = $('nodes').value, box = $('parameters');
  if (!node) return;
  const answer = await request('parameters', { node });
  box.replaceChildren();
  if (!answer.done) { made(box, 'p', answer.words); return; }
  if (!answer.parameters.length) made(box, 'p', 'This node has no parameter that can be changed while it runs.');
  for (const parameter of answer.parameters) {
    const label = made(box, 'label', ''), input = document.createElement('input');
    made(label, 'span', parameter.name); label.append(input);
    const note = made(label, 'span', `${parameter.words}${parameter.bounds ? ` (${parameter.bounds[0]} to ${parameter.bounds[1]})` : ''}`);
    const flag = typeof parameter.value === 'boolean', numeric = typeof parameter.value === 'number';
    input.type = flag ? 'checkbox' : numeric ? 'number' : 'text';
    if (numeric) { input.step = 'any'; if (parameter.bounds) [input.min, input.max] = parameter.bounds; }
    if (flag) input.checked = parameter.value; else input.value = parameter.value;
    input.onchange = async () => {
      const result = await request('set', { node, name: parameter.name, value: flag ? input.checked : numeric ? Number(input.value) : input.value });
      note.textContent = result.done ? `${parameter.words} — set` : `Refused: ${result.words}`;
    };
  }
};

function showRigs(rigs) {
  $('rigs').hidden = rigs.length < 2;
  options('rigs', rigs.map(name => [name, name.slice(1) || '(no namespace)']));
  $('rigs').value = rig;
}
$('rigs').onchange = () => { rig = $('rigs').value; rows = []; tails.clear(); bagsAsked = -Infinity; pictureTime = 0; ask('watch', { rig }); };

connect();
