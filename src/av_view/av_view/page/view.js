// The page: shows what the server sends, and asks it for the next update when the previous one is shown.
'use strict';

const WINDOW_S = 60, RETRY_MS = 1000;
const STATE_WORDS = { none: 'no target', sight: 'by sight', sound: 'by sound', coasting: 'predicted' };
const [TIME, SOUND, MIRROR, SIGHT, FUSED, SIGMA, TRUTH, SOUND_CONFIDENCE, SIGHT_CONFIDENCE, STATE, DELAY, SNR] = Array(12).keys(), DELAY_MS = 12;
const $ = id => document.getElementById(id);
const color = name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const token = location.hash.slice(1) || sessionStorage.getItem('token') || '';
if (location.hash) { sessionStorage.setItem('token', token); history.replaceState(null, '', location.pathname); }

let socket, pending, bagsAsked = -Infinity, number = 0, rig = null, rows = [], state = null, nodes = [], offers = [], control = false, northUp = false, pictureTime = 0;
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
    if (rows.length && message.rows[0]?.[TIME] < rows[rows.length - 1][TIME]) rows = []; // a replay that began again
    rows.push(...message.rows);
    while (rows[0]?.[TIME] < rows[rows.length - 1][TIME] - WINDOW_S) rows.shift();
    requestAnimationFrame(() => { state = message.state; if (state) show(); if (socket.readyState === 1) ask('next'); });
  } else if (message.type === 'health') {
    ({ nodes, offers } = message); showHealth(); showPointing();
  } else if (message.type === 'rigs') {
    control = message.control; rig ??= message.rig; showRigs(message.rigs);
    if (state === null && message.rigs.length && !message.rigs.includes(rig)) watch(message.rigs[0]);
  } else if (message.type === 'answer') {
    answers.get(message.number)?.(message); answers.delete(message.number);
  }
}

function lost() {
  for (const resolve of answers.values()) resolve({ done: false, words: 'the connection was lost' });
  answers.clear(); rows = []; state = null;
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
  for (const button of ['enable', 'turn', 'select', 'record', 'pause'].map($)) { button.disabled = !permitted; button.hidden = !permitted || !offers.includes(button.id); }
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
  $('seek-box').hidden = !offers.includes('pause'); $('seek').disabled = $('pause').disabled; $('seek').max = length || 0;
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
function watch(name) { rig = $('rigs').value = name; rows = []; tails.clear(); bagsAsked = -Infinity; pictureTime = 0; ask('watch', { rig }); }
$('rigs').onchange = () => watch($('rigs').value);

connect();
