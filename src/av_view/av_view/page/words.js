// What the page says, for people: from plain data to text, without the document.
'use strict';

const signed = (value, digits = 1) => (value > 0 ? '+' : '') + value.toFixed(digits);
const percent = value => `${value < 1 ? Math.min(99, Math.round(100 * value)) : 100} %`;
const sure = value => value === null || value === undefined ? '' : `, sure to ${percent(Math.min(value, 0.99))}`; // nothing is certain
const listed = words => words.length < 2 ? words.join('') : `${words.slice(0, -1).join(', ')} and ${words[words.length - 1]}`;
const SENSES = { sound: 'heard', sight: 'seen' };
const NODES = { audio_node: 'microphones', doa_node: 'hearing', camera_node: 'camera', detector_node: 'detector', fusion_node: 'fusion', pointing_node: 'pointing',
  bridge_node: 'link to the simulator', recorder_node: 'recorder', player_node: 'replay', px4_node: 'link to the autopilot', rig_frames_node: 'frames of the rig',
  monitor_node: 'monitor', report_node: 'reports', network_node: 'network', view_node: 'this page' };
const INPUTS = { doa: 'directions of sound', detections: 'detections of the camera', 'second_camera/detections': 'detections of the second camera', odometry: 'the attitude of the rig', 'target/bearing': 'the bearing' };

// "drone 1": the type by its sound stays a detail, and what is probably no drone has the name of what it may be.
function nameOf({ id, name, drone }) {
  const plain = (name ?? '').replaceAll('_', ' ');
  return `${drone === null || drone === undefined ? plain || 'target' : drone >= 0.5 ? 'drone' : /drone|copter|rotor/.test(plain) ? 'something' : plain || 'something'} ${id}`;
}

function stateWords(bearing, fusion) {
  if (!bearing) return 'no bearing';
  return { none: 'no target', coasting: 'predicted', sight: `seen${sure(fusion?.sight_confidence)}`, sound: `heard${sure(fusion?.sound_confidence)}` }[bearing.state];
}

function bearingWords(bearing) {
  if (!bearing || bearing.state === 'none') return '';
  const side = Math.abs(bearing.azimuth) > 90 ? 'behind' : 'ahead', hand = bearing.azimuth > 0 ? 'left' : 'right';
  return `${signed(bearing.azimuth)}° ± ${bearing.sigma ?? '?'}°${bearing.range ? `, ${Math.round(bearing.range)} m` : ''}, ${bearing.resolved ? `${side}, ${hand}` : `${hand}, ahead or behind`}`;
}

// Why it is so, and what is missing. Reasons of fusion that are no sentence yet become one, all others stay as they are.
function reasonWords(bearing, fusion) {
  if (!fusion) return '';
  const reason = fusion.reason
    .replace(/^no target: /, '')
    .replace(/(heard|seen) at ([+-]?\d+) deg, judged not a drone \((0?\.\d+|1\.0*|0)\)/, (_, sense, azimuth, p) => `${sense} at ${azimuth}° and not followed: a drone to ${percent(Number(p))} only`)
    .replace(/^sight confidence [\d.]+ >= [\d.]+$/, '')
    .replace(/sight confidence ([\d.]+) < ([\d.]+)/, (_, score, least) => `seen to ${percent(Number(score))}, ${percent(Number(least))} are needed`)
    .replace(' and no recent direction of arrival that fits the track: it is predicted', ', and not heard recently')
    .replace(/(\S+) has (\d+) publishers \(([^)]*)\)/g, (_, topic, count, names) => `${INPUTS[topic] ?? topic} come from ${count} programs (${names}) and are not used`);
  const missing = fusion.missing.map(name => INPUTS[name] ?? name);
  return [reason, missing.length ? `${listed(missing)} ${missing.length > 1 || /^d/.test(missing[0]) ? 'are' : 'is'} missing` : ''].filter(Boolean).join('; ');
}

// One line for each target: which is followed, and why the others are not.
function targetWords(track) {
  const senses = track.source.map(name => SENSES[name]), type = (track.name ?? '').replaceAll('_', ' '), name = nameOf(track);
  const direction = track.azimuth === null ? 'in an unknown direction' : `at ${signed(track.azimuth, 0)}°`;
  const where = `${senses.length ? listed(senses) : 'predicted'} ${direction}${track.range ? `, ${Math.round(track.range)} m` : ''}`;
  const drone = track.drone === null ? 'not yet classified' : `a drone to ${percent(track.drone)}`;
  return `${name}${type && !name.startsWith(type) && type !== 'drone' ? ` (${type})` : ''}: ${where}; ${track.selected ? 'followed' : 'not followed'}, ${drone}`;
}

const COMMANDS = { hold: 'Stands still', track: 'Follows', search: 'Rotates to resolve front and back', look: 'The gimbal searches' };
function commandWords(command) {
  if (!command) return 'No commands.';
  const parts = [command.pan === null ? '' : `gimbal at ${signed(command.pan, 0)}°, ${signed(command.tilt, 0)}°`, command.yaw_rate ? `body turns at ${signed(command.yaw_rate, 0)}°/s` : ''].filter(Boolean);
  return `${COMMANDS[command.mode]}${command.reason === 'following the bearing' ? '' : `: ${command.reason}`}${parts.length ? ` (${parts.join('; ')})` : ''}.`;
}

// What may move, by what pointing_node is configured to command; null while it has not said so.
function whatMoves(configured) {
  if (configured === undefined || configured === null) return 'the gimbal and the body of the rig (its configuration is not known yet)';
  return configured === 'nothing' ? null : configured;
}

// What is asked before something may move; the words follow from the configuration, never from the newest command.
function askWords(action, configured, target = '') {
  const moves = whatMoves(configured), end = 'Is everybody clear of it?';
  if (moves === null) return 'Nothing of this rig is configured to move (move_gimbal and move_body of pointing_node are false). Go on nevertheless?';
  const what = { enable: `From now on this moves by itself towards the target: ${moves}.`,
    turn: `Until front and back are resolved, for 10 s at most, this turns by itself: ${moves}.`,
    select: `This moves towards ${target}: ${moves}.` }[action];
  return `${what} ${end}`;
}

function healthWords(nodes) {
  const bad = nodes.filter(node => node.level !== 'ok');
  return !nodes.length ? 'no node reports' : !bad.length ? `all ${nodes.length} nodes are OK` : `${bad.length} of ${nodes.length} nodes need attention`;
}

// A node's name for people, and what it says about inputs that it refuses.
const nodeWords = node => { const name = node.split('/').pop(), camera = /^(.*)_(?:camera|detector)_node$/.exec(name); return NODES[name] ?? (camera ? name.replaceAll('_', ' ') : name); };
function statusWords(words) {
  return words
    .replace(/(\S+) has (\d+) publishers \(([^)]*)\) and is not used/g, (_, topic, count, names) => `${INPUTS[topic] ?? topic} (${topic}) come from ${count} programs (${names}) and are not used`)
    .replace(/(\S+) refused: /g, (_, topic) => `cannot use ${INPUTS[topic.replace(/^\//, '')] ?? topic}: `)
    .replace(/^active(?:; )?/, '') || 'works';
}
