// The page: shows what the server sends, and asks it for the next update when the previous one is shown.
'use strict';

const WINDOW_S = 60, RETRY_MS = 1000;
const [TIME, SOUND, MIRROR, SIGHT, FUSED, SIGMA, TRUTH, SOUND_CONFIDENCE, SIGHT_CONFIDENCE, STATE, DELAY, LEVEL] = Array(12).keys(), [DELAY_MS, OFF_SOUND, OFF_SIGHT, OFF_FUSED] = [12, 13, 14, 15];
const $ = id => document.getElementById(id);
const color = name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const kept = given => { try { if (given) sessionStorage.setItem('token', given); return sessionStorage.getItem('token') ?? ''; } catch { return given; } }; // some browsers keep nothing
const token = kept(location.hash.slice(1));
if (location.hash) history.replaceState(null, '', location.pathname);
window.onhashchange = () => location.reload(); // another token

let socket, pending, retry, bagsAsked = -Infinity, tuningAsked = -Infinity, number = 0, serial = 0, followed = 0, chosen = null, rows = [], state = null, nodes = [], offers = [], control = false, permitted = false, northUp = false;
let pictureUrl = '';
const answers = new Map(), tails = new Map(), mapTails = new Map();

// A page that nobody sees is not connected, and costs the rig nothing.
function connect() {
  clearTimeout(retry);
  if (document.hidden || socket?.readyState < 2) return;
  const made = socket = new WebSocket(new URL('feed', location.href).href.replace(/^http/, 'ws'), token ? ['rig', token] : ['rig']);
  socket.binaryType = 'blob';
  socket.onopen = () => ask('watch', chosen === null ? {} : { rig: chosen });
  socket.onmessage = event => typeof event.data === 'string' ? take(JSON.parse(event.data)) : showPicture(event.data);
  socket.onclose = () => { if (made === socket) { lost(); retry = setTimeout(connect, RETRY_MS); } };
}
document.onvisibilitychange = () => document.hidden ? socket?.close() : connect();

function ask(action, values = {}) { if (socket.readyState === 1) socket.send(JSON.stringify({ do: action, ...values })); }

// A request that needs the token; resolves to the answer.
function request(action, values = {}) {
  return new Promise(resolve => {
    if (socket.readyState !== 1) { resolve({ done: false, words: 'no connection' }); return; }
    answers.set(++number, resolve); ask(action, { ...values, number });
  });
}

function take(message) {
  if (message.type === 'state') {
    const missed = message.serial < serial ? message.rows.length : Math.min(message.serial - serial, message.rows.length), fresh = missed ? message.rows.slice(-missed) : [];
    serial = message.serial;
    for (const row of fresh) { if (rows.length && row[TIME] < rows[rows.length - 1][TIME]) rows = []; rows.push(row); } // a replay may begin again
    while (rows[0]?.[TIME] < rows[rows.length - 1][TIME] - WINDOW_S) rows.shift();
    requestAnimationFrame(() => { state = message.state; document.body.classList.remove('lost'); try { if (state) show(); } finally { ask('next'); } });
  } else if (message.type === 'health') {
    ({ nodes, offers } = message); showHealth(); showPointing();
  } else if (message.type === 'rigs') {
    ({ control, token: permitted } = message); showRigs(message.rigs, message.rig);
  } else if (message.type === 'answer') {
    answers.get(message.number)?.(message); answers.delete(message.number);
  }
}

function lost() {
  for (const resolve of answers.values()) resolve({ done: false, words: 'the connection was lost' });
  answers.clear(); forget(); document.body.classList.add('lost');
  say('no connection', 'lost', 'The rig does not answer; trying again. Nothing can be stopped from here now.');
  for (const button of document.querySelectorAll('#stop, #side button, #side select, #side input')) button.disabled = true;
}

function forget() { rows = []; state = null; serial = followed = 0; nodes = []; tails.clear(); mapTails.clear(); bagsAsked = tuningAsked = -Infinity; }

function say(chip, kind, words) {
  $('state').textContent = chip; $('state').className = `chip ${kind}`; $('bearing').value = ''; $('reason').textContent = $('reason').title = words;
}

function showPicture(blob) {
  const old = pictureUrl;
  pictureUrl = $('picture').src = URL.createObjectURL(blob);
  if (old) URL.revokeObjectURL(old);
}

function show() {
  const { bearing, fusion, tracks } = state;
  say(stateWords(bearing, fusion), bearing ? bearing.state : '', reasonWords(bearing, fusion));
  $('bearing').value = bearingWords(bearing);
  $('targets').replaceChildren();
  for (const track of [...tracks].sort((a, b) => b.selected - a.selected)) made($('targets'), 'li', targetWords(track), track.selected ? 'selected' : '');
  showOverlay(); showPolar(); showMap(); showAzimuths(); showErrors(); showConfidences(); showLevel(); showDelays(); showSpectrum();
  $('command').textContent = commandWords(state.command);
}

const valueOf = (node, key) => nodes.find(one => one.node.endsWith(`/${node}`))?.values.find(([name]) => name === key)?.[1];

function showPointing() {
  const told = valueOf('pointing_node', 'enabled'), enabled = told === 'True', moves = whatMoves(valueOf('pointing_node', 'may move'));
  $('moves').textContent = !offers.includes('enable') ? '' : enabled ? `It moves by itself: ${moves ?? 'but nothing is configured to move'}.` : told === undefined ? 'Whether commands move it is not known yet.' : 'Commands move nothing.';
  for (const id of ['enable', 'turn', 'select', 'record', 'pause']) { $(id).disabled = false; $(id).hidden = !permitted || !offers.includes(id); }
  $('enable').hidden ||= enabled;
  $('stop-bar').hidden = !permitted || !offers.includes('enable'); $('stop').disabled = false;
  document.body.classList.toggle('stoppable', !$('stop-bar').hidden);
  const unresolved = state?.bearing && state.bearing.state !== 'none' && !state.bearing.resolved;
  $('turn').disabled = !enabled || !unresolved;
  $('turn').title = !enabled ? 'Commands move nothing.' : unresolved ? '' : 'Front and back are told apart, or there is no target.';
  options('select', [[0, 'Follow a target by policy'], ...(state?.tracks ?? []).map(track => [track.id, `Follow ${nameOf(track)}`])]);
  if (!permitted) $('answer').textContent = control ? 'Read-only: open the address with the token.' : 'Read-only. The rig is controlled here with view_control:=true.';
  showRecording(); showTuning();
}

function showRecording() {
  $('mark').hidden = !permitted; $('seek-box').hidden = !offers.includes('pause');
  if (permitted && !$('pause').hidden && performance.now() - bagsAsked > 10000) {
    bagsAsked = performance.now();
    request('bags').then(({ bags }) => options('open', [['', 'Open a bag…'], ...(bags ?? []).map(name => [name, name])]));
  }
  $('open').hidden = $('pause').hidden || $('open').length < 2;
  $('record-box').hidden = !permitted && $('seek-box').hidden;
  const recording = nodes.some(one => one.node.endsWith('/recorder_node') && one.words !== 'not active');
  $('record').textContent = recording ? 'Stop recording' : 'Start recording'; $('record').value = recording ? '' : 'yes';
  const paused = valueOf('player_node', 'paused') === 'True';
  $('pause').textContent = paused ? 'Play' : 'Pause'; $('pause').value = paused ? '' : 'yes';
  const [position, length] = (valueOf('player_node', 'position') ?? '').split(' of ').map(parseFloat);
  $('seek').disabled = !permitted; $('seek').max = length || 0;
  if (document.activeElement !== $('seek')) $('seek').value = position || 0;
  $('position').value = valueOf('player_node', 'position') ?? '';
  for (const id of ['open', 'mark-text']) $(id).disabled = false;
  $('mark').querySelector('button').disabled = false;
}

async function act(action, values) {
  $('answer').textContent = '…';
  const answer = await request(action, values);
  $('answer').textContent = (answer.done ? '' : 'Refused: ') + (answer.words || 'done');
  if (action === 'select' && answer.done) { followed = values.value; showFollowed(); }
}

$('stop').onclick = () => { if ($('ask').open) $('ask').close('no'); act('enable', { value: false }); };
$('enable').onclick = () => confirmMove('enable', '', { value: true });
$('turn').onclick = () => confirmMove('turn', '');
$('select').onchange = () => {
  const value = Number($('select').value), track = state?.tracks.find(one => one.id === value);
  showFollowed(); // until it is carried out: what was cancelled or refused can be chosen again
  if (valueOf('pointing_node', 'enabled') === 'False') act('select', { value });
  else confirmMove('select', track ? nameOf(track) : 'the target that the policy chooses', { value });
};
const showFollowed = () => { $('select').value = followed; if (!$('select').value) $('select').value = 0; };
$('open').onchange = () => { act('open', { value: $('open').value }); $('open').value = ''; };
$('mark').onsubmit = event => { event.preventDefault(); act('mark', { value: $('mark-text').value }); $('mark-text').value = ''; };

// Ask before something moves.
function confirmMove(action, target, values = {}) {
  pending = [action, values];
  $('ask-words').textContent = askWords(action, valueOf('pointing_node', 'may move'), target);
  $('ask').returnValue = ''; $('ask').close(); $('ask').show(); // not modal: the stop stays in reach
}
$('ask').onclose = () => { if ($('ask').returnValue === 'yes') act(...pending); $('ask').returnValue = ''; };
for (const id of ['record', 'pause']) $(id).onclick = () => act(id, { value: Boolean($(id).value) });
$('seek').onchange = () => { act('seek', { value: Number($('seek').value) }); $('seek').blur(); };
$('orientation').onclick = () => { northUp = !northUp; $('orientation').textContent = northUp ? 'north' : 'ahead'; };

function made(parent, name, text, kind = '') {
  const child = document.createElement(name);
  child.textContent = text; child.className = kind;
  return parent.appendChild(child);
}

function showHealth() {
  const open = new Set([...document.querySelectorAll('#health details[open]')].map(details => details.dataset.node));
  const bad = nodes.filter(node => node.level !== 'ok');
  $('health-note').textContent = healthWords(nodes);
  $('problems').hidden = !bad.length; $('problems').textContent = `⚠ ${bad.length}`; $('problems').title = bad.map(node => `${nodeWords(node.node)}: ${statusWords(node.words)}`).join('\n');
  $('health').replaceChildren();
  for (const node of nodes) {
    const item = made($('health'), 'li', '', node.level), details = made(item, 'details', ''), summary = made(details, 'summary', '');
    details.dataset.node = node.node; details.open = open.has(node.node);
    made(summary, 'b', nodeWords(node.node)); summary.append(` ${statusWords(node.words)}`); summary.title = node.node;
    const table = made(details, 'table', '');
    for (const [key, value] of node.values) { const row = made(table, 'tr', ''); made(row, 'td', key); made(row, 'td', value); }
    for (const advice of node.advice) made(item, 'p', advice, 'advice');
  }
}

// Change what a list offers, and keep what is chosen.
function options(id, entries) {
  const list = $(id), offered = JSON.stringify(entries), chosen = list.value;
  if (list.dataset.offered === offered) return;
  list.dataset.offered = offered;
  list.replaceChildren(...entries.map(([value, text]) => new Option(text, value)));
  list.value = entries.some(([value]) => String(value) === chosen) ? chosen : entries[0]?.[0];
}

// What people tune while they look, asked for once.
async function showTuning() {
  if (!permitted || performance.now() - tuningAsked < 5000 || $('tuning').childElementCount && tuningAsked > 0) return;
  tuningAsked = performance.now();
  const { parameters = [] } = await request('tuning');
  $('tuning-box').hidden = !parameters.length; $('tuning').replaceChildren();
  for (const { node, name, value, bounds, words } of parameters) {
    const line = made($('tuning'), 'label', ''), input = document.createElement('input');
    made(line, 'span', words); line.append(input); line.title = `${name} of ${node}, ${bounds ? `${bounds[0]} to ${bounds[1]}` : 'any value'}`;
    const note = made(line, 'small', '');
    Object.assign(input, { type: 'number', step: 'any', value }); if (bounds) [input.min, input.max] = bounds;
    input.onchange = async () => { const { done, words } = await request('set', { node, name, value: Number(input.value) }); note.textContent = done ? 'set' : `Refused: ${words}`; };
  }
}

function showRigs(rigs, shown) {
  $('rigs').hidden = rigs.length < 2; $('rigs').disabled = false;
  options('rigs', rigs.map(name => [name, name.slice(1) || '(no namespace)']));
  $('rigs').value = shown;
  if (!rigs.length) say('no rig', 'lost', 'No rig is found. Is one running, with the same ROS_DOMAIN_ID as this page?');
}
$('rigs').onchange = () => { chosen = $('rigs').value; forget(); $('tuning').replaceChildren(); ask('watch', { rig: chosen }); };

connect();
