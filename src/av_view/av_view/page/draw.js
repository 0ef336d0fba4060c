// What is drawn of a rig: overlay of the picture, directions from above, map, and diagrams.
'use strict';

const TAIL_S = 15, RIM = 84, ERROR_DEG = 5, JUMP = 20; // degrees from which a tail is broken, as where front and back change places

function element(parent, name, attributes, text) {
  const made = document.createElementNS('http://www.w3.org/2000/svg', name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return parent.appendChild(made);
}

function showOverlay() {
  const { picture, sight, tracks } = state, image = $('picture'), svg = $('overlay'), width = image.naturalWidth || 640, height = image.naturalHeight || 480;
  image.hidden = !picture || !image.src; $('no-picture').hidden = !image.hidden;
  document.documentElement.style.setProperty('--aspect', width / height);
  svg.setAttribute('viewBox', `0 0 ${width} ${height}`);
  svg.replaceChildren();
  $('picture-note').textContent = !picture ? '' : [picture.age > 0.15 ? `${picture.age.toFixed(1)} s ago` : 'now', picture.detected ? `${picture.boxes.length || 'nothing'} seen` : sight ? 'detections of other pictures are not drawn' : 'no detections'].join(', ');
  if (!picture) return;
  const path = points => points.map(([x, y]) => `${x * width},${y * height}`).join(' ');
  if (picture.band.length) element(svg, 'polygon', { class: 'band', points: path(picture.band) });
  for (const heard of picture.heard) if (heard.length) element(svg, 'polyline', { class: 'heard', points: path(heard) });
  if (picture.line.length) element(svg, 'polyline', { class: 'line', points: path(picture.line) });
  if (picture.centre) element(svg, 'circle', { class: 'centre', cx: picture.centre[0] * width, cy: picture.centre[1] * height, r: 14 });
  for (const box of picture.boxes) if (![box.x, box.y, box.width, box.height].includes(null)) {
    element(svg, 'rect', { class: 'box', x: box.x * width, y: box.y * height, width: box.width * width, height: box.height * height });
    label(svg, box.x * width, Math.max(box.y * height - 5, 14), `${box.name === 'drone' ? '' : `${box.name.replaceAll('_', ' ')} `}seen${sure(box.score)}`, width);
  }
  for (const track of tracks) if (track.point) label(svg, track.point[0] * width + 16, track.point[1] * height + 28, nameOf(track), width);
}

// A text that stays within the picture.
function label(svg, x, y, words, width) {
  const text = element(svg, 'text', { x, y }, words);
  text.setAttribute('x', Math.max(2, Math.min(x, width - 4 - text.getComputedTextLength())));
}

// A name where there is room beside a place; those of the first have it, and the list has all.
function nameBeside(svg, taken, x, y, words) {
  const left = x + 6, width = 5 * words.length;
  if (taken.some(box => Math.abs(y - box.y) < 10 && left < box.left + box.width && box.left < left + width)) return;
  taken.push({ left, width, y }); element(svg, 'text', { class: 'name', x: left, y: y + 3 }, words);
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
  const svg = $('polar'), { bearing, cameras, sound, sight, truth, tracks, heading, posterior } = state, bins = posterior.length;
  svg.replaceChildren();
  for (const radius of [RIM / 2, RIM]) element(svg, 'circle', { class: 'rim', r: radius });
  const marks = northUp ? { E: 0, N: 90, W: 180, S: -90 } : { ahead: 0, left: 90, behind: 180, right: -90 };
  for (const [name, azimuth] of Object.entries(marks)) {
    const [x, y] = at(northUp ? azimuth - (heading ?? 0) : azimuth, RIM + 27);
    element(svg, 'text', { x, y: y + 3, 'text-anchor': 'middle' }, name);
  }
  for (const camera of cameras) element(svg, 'polygon', { class: 'view', points: wedge(camera.azimuth - camera.view / 2, camera.azimuth + camera.view / 2, 6, RIM) });
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
  showTracks(svg, tracks.filter(track => track.azimuth !== null));
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
  const taken = [];
  for (const track of [...tracks].sort((a, b) => b.selected - a.selected)) {
    const offset = track.azimuth_world === null ? 0 : track.azimuth - track.azimuth_world, [cx, cy] = at(track.azimuth, level(track));
    element(svg, 'path', { class: 'tail', d: tails.get(track.id).map(([, azimuth, radius], i, all) =>
      `${i && Math.abs(difference(azimuth, all[i - 1][1])) < JUMP ? 'L' : 'M'}${at(azimuth + offset, radius)}`).join('') });
    element(svg, 'circle', { class: `track ${track.selected ? 'selected' : ''}`, cx, cy, r: 3.5 });
    nameBeside(svg, taken, cx, cy, `${nameOf(track)}${track.range ? `, ${Math.round(track.range)} m` : ''}`);
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
  const half = Math.max(10, 0.65 * (high[0] - low[0]) * 9 / 16, 0.65 * (high[1] - low[1])), scale = 90 / half, place = (x, y) => [(x - (low[0] + high[0]) / 2) * scale, ((low[1] + high[1]) / 2 - y) * scale];
  const taken = [], text = (x, y, words) => nameBeside(svg, taken, x, y, words);
  for (const track of [...tracks].sort((a, b) => b.positioned - a.positioned)) {
    const [cx, cy] = place(track.x, track.y), [long, short, angle] = track.ellipse;
    for (const rig of rigs) if (track.rigs.includes(rig.name)) { const [x1, y1] = place(rig.x, rig.y); element(svg, 'line', { class: 'sight-line', x1, y1, x2: cx, y2: cy }); }
    element(svg, 'polyline', { class: 'tail', points: points(mapTails.get(track.id).map(([, x, y]) => place(x, y))) });
    if (track.positioned) element(svg, 'ellipse', { class: 'sigma', cx, cy, rx: long * scale, ry: short * scale, transform: `rotate(${-angle} ${cx} ${cy})` });
    element(svg, 'circle', { class: `track ${track.positioned ? 'selected' : ''}`, cx, cy, r: 3 });
    text(cx, cy, [nameOf(track), track.positioned ? `${Math.round(track.z)} m up` : 'distance unknown'].join(', '));
  }
  for (const rig of rigs) { const [x, y] = place(rig.x, rig.y); element(svg, 'rect', { class: 'rig', x: x - 3, y: y - 3, width: 6, height: 6 }); text(x, y, rig.name || 'rig'); }
  const step = 10 ** Math.floor(Math.log10(half)), length = step * [5, 2, 1].find(one => one * step <= half);
  element(svg, 'line', { class: 'scale', x1: -150, x2: -150 + length * scale, y1: 82, y2: 82 });
  element(svg, 'text', { x: -150, y: 78 }, `${length} m`);
  $('map-note').textContent = `${tracks.length} ${tracks.length === 1 ? 'target' : 'targets'} by ${rigs.length} rigs, north is up`;
}

// A diagram of the last minute; returns its context and scales.
function diagram(id, low, high, lines) {
  const canvas = $(id), ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight, left = 34;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) { canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio); }
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

// What is off by less than ERROR_DEG, against the truth of a simulation, or else against the fused bearing; more stands at the edge.
function showErrors() {
  const known = rows.some(row => row[TRUTH] !== null), scale = diagram('errors', -ERROR_DEG, ERROR_DEG, [-5, 0, 5]), { context, x, y } = scale;
  $('error-note').textContent = known ? 'error against the truth, ± 5 deg' : 'sound and sight against the fused bearing, ± 5 deg';
  const edge = value => Math.max(-ERROR_DEG, Math.min(ERROR_DEG, value));
  const off = (row, column) => row[column] === null || row[known ? TRUTH : FUSED] === null ? null : edge(difference(row[column], row[known ? TRUTH : FUSED]));
  for (const row of rows) {
    const centre = row[FUSED] === null ? null : known ? row[TRUTH] === null ? null : difference(row[FUSED], row[TRUTH]) : 0, nearer = [SOUND, MIRROR].map(column => off(row, column)).filter(value => value !== null);
    [row[OFF_SOUND], row[OFF_SIGHT], row[OFF_FUSED]] = [nearer.length ? nearer.reduce((a, b) => Math.abs(b) < Math.abs(a) ? b : a) : null, off(row, SIGHT), centre === null ? null : edge(centre)];
    if (centre === null || row[SIGMA] === null) continue;
    context.fillStyle = color('fused'); context.globalAlpha = 0.2;
    const [top, low] = [edge(centre + row[SIGMA]), edge(centre - row[SIGMA])];
    context.fillRect(x(row[TIME]) - 1, y(top), 2, y(low) - y(top)); context.globalAlpha = 1;
  }
  dots(scale, OFF_SOUND, 'sound', 2.5, 0.8); dots(scale, OFF_SIGHT, 'sight', 3.5); line(scale, OFF_FUSED, 'fused', 2);
}

function showConfidences() {
  const scale = diagram('confidences', -0.12, 1, [0, 0.5, 1]), { context, x, y } = scale;
  line(scale, SOUND_CONFIDENCE, 'sound', 1.5); line(scale, SIGHT_CONFIDENCE, 'sight', 1.5);
  for (const row of rows) if (row[STATE] !== 'none') { context.fillStyle = color(row[STATE]); context.fillRect(x(row[TIME]) - 1, y(-0.03), 2.5, 5); }
}

function showLevel() { line(diagram('level', -100, 0, [-80, -40, 0]), LEVEL, 'sound', 1.5); }

function showDelays() {
  const most = Math.max(0.1, ...rows.map(row => row[DELAY] ?? 0)), top = most > 0.5 ? Math.ceil(most) * 1000 : Math.ceil(most * 10) * 100;
  rows.forEach(row => { row[DELAY_MS] = row[DELAY] === null ? null : 1000 * row[DELAY]; });
  line(diagram('delays', 0, top, [0, top / 2, top]), DELAY_MS, 'fused', 1.5);
}

function showSpectrum() {
  const { context, y, width, height, left } = diagram('spectrum', -100, 0, [-80, -40, 0]), bands = state.spectrum.length, step = (width - left) / Math.max(bands, 1);
  context.fillStyle = color('sound');
  state.spectrum.forEach((level, i) => { const top = y(Math.max(level, -100)); context.fillRect(left + i * step, top, Math.max(step - 1, 1), height - 6 - top); });
  context.fillStyle = color('quiet');
  for (const [hertz, align] of bands ? [[100, 'left'], [1000, 'center'], [10000, 'right']] : []) {
    context.textAlign = align;
    context.fillText(hertz < 1000 ? `${hertz} Hz` : `${hertz / 1000} kHz`, left + (width - left) * Math.log(hertz / 60) / Math.log(20000 / 60), 8);
  }
}
