// Values from the page's data blocks, and how they are written for people.

/** The content of a JSON block. */
function readBlock(element) {
  return JSON.parse(element.textContent);
}

/** A number of the data as a number: JSON has no infinities, so they come as words. */
function toNumber(value) {
  if (value === '∞') return Infinity;
  if (value === '-∞') return -Infinity;
  return value === null ? NaN : value;
}

/** A number with its sign, `+1.20`; a dash where it is not known. */
function signed(value, decimals = 2) {
  if (Number.isNaN(value)) return '–';
  const sign = value < 0 ? '−' : '+';
  return sign + (Number.isFinite(value) ? Math.abs(value).toFixed(decimals) : '∞');
}

function clamp(value, low, high) {
  return Math.min(Math.max(value, low), high);
}

/** A new element with properties and children; words become text, never markup. */
function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  Object.assign(element, properties);
  element.append(...children);
  return element;
}

/** A new SVG element with attributes. */
function makeSvg(tag, attributes = {}, ...children) {
  const element = document.createElementNS('http://www.w3.org/2000/svg', tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}
