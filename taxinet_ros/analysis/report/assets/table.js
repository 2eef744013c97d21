// A table that sorts by its headers, filters by words, turns pages and copies itself as CSV.

const ABSENT = '–';
const LONG = 40;
const collator = new Intl.Collator('en', { numeric: true });

/** Numbers before words; `null` is kept out by the caller. */
function compareCells(a, b) {
  const [x, y] = [a, b].map((cell) => (typeof cell === 'string' ? cell : Number(cell)));
  if (typeof x === 'number' && typeof y === 'number') return x < y ? -1 : Number(x > y);
  if (typeof x === typeof y) return collator.compare(x, y);
  return typeof x === 'number' ? -1 : 1;
}

function compareNumbers(a, b) {
  return compareCells(toNumber(a), toNumber(b));
}

/** One CSV field. Words that a spreadsheet would take for a formula get an apostrophe. */
function csvField(text, isText) {
  const safe = isText && /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
  return /[",\r\n]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
}

class ReportTable {
  constructor(root, viewers) {
    const data = readBlock(root.querySelector('.table-data'));
    this.root = root;
    this.viewers = viewers;
    this.columns = data.columns;
    this.runColumn = data.runColumn;
    this.rowsAtOnce = data.rowsAtOnce;
    this.rows = data.rows.map((cells) => ({ cells, words: this.searchWords(cells) }));
    this.chosen = this.rows;
    this.sorted = { column: -1, descending: false };
    this.first = 0;
    this.printing = false;
    this.listen();
    this.keepWidths();
    this.showState();
  }

  find(selector) {
    return this.root.querySelector(selector);
  }

  listen() {
    this.headers = [...this.root.querySelectorAll('th')];
    this.headers.forEach((header, column) => {
      header.firstElementChild.addEventListener('click', () => this.sortBy(column));
    });
    this.find('.table-filter')?.addEventListener('input', () => this.choose());
    this.find('.table-more').addEventListener('click', () => this.showMore());
    this.find('.page-before')?.addEventListener('click', () => this.turn(-1));
    this.find('.page-after')?.addEventListener('click', () => this.turn(1));
    addEventListener('beforeprint', () => this.print(true));
    addEventListener('afterprint', () => this.print(false));
    this.find('.table-scroll').addEventListener('scroll', () => this.showHidden());
    const sizes = new ResizeObserver(() => this.showHidden());
    for (const part of ['.table-scroll', 'table']) sizes.observe(this.find(part));
    this.find('.table-copy').addEventListener('click', (event) => this.copy(event.target));
  }

  /** The words in a cell, as people read them. */
  text(cell, column) {
    if (cell === null) return ABSENT;
    if (typeof cell === 'boolean') return cell ? 'yes' : 'no';
    const { decimals } = this.columns[column];
    return typeof cell === 'number' && decimals !== null ? cell.toFixed(decimals) : String(cell);
  }

  /** The same with a true minus, as all of the page has it; copies keep the one of keyboards. */
  shown(cell, column) {
    const text = this.text(cell, column);
    const isNumber = typeof cell === 'number' || cell === '-∞';
    return isNumber && this.columns[column].decimals !== null ? text.replace('-', '−') : text;
  }

  /** How a cell is set: numbers to the right, long words in several lines. */
  kind(text, column) {
    if (this.columns[column].numeric) return 'number';
    return text.length > LONG ? 'long' : '';
  }

  searchWords(cells) {
    const words = cells.flatMap((cell, column) => [
      this.text(cell, column), this.shown(cell, column),
    ]);
    return words.join('\n').toLowerCase();
  }

  /** Sort ascending, at the second click descending; what is not known stays last. */
  sortBy(column) {
    const again = this.sorted.column === column;
    this.sorted = { column, descending: again && !this.sorted.descending };
    this.headers.forEach((header, place) => {
      const order = this.sorted.descending ? 'descending' : 'ascending';
      header.setAttribute('aria-sort', place === column ? order : 'none');
    });
    this.choose();
  }

  order(a, b) {
    const { column, descending } = this.sorted;
    const [x, y] = [a.cells[column], b.cells[column]];
    if (x === null || y === null) return Number(x === null) - Number(y === null);
    const compare = this.columns[column].numeric ? compareNumbers : compareCells;
    return descending ? compare(y, x) : compare(x, y);
  }

  /** Rows that hold every word of the filter, sorted. */
  choose() {
    const wanted = (this.find('.table-filter')?.value ?? '').toLowerCase().split(/\s+/);
    this.chosen = this.rows.filter((row) => wanted.every((word) => row.words.includes(word)));
    if (this.sorted.column >= 0) this.chosen.sort((a, b) => this.order(a, b));
    this.first = 0;
    this.show();
  }

  turn(pages) {
    this.first += pages * this.rowsAtOnce;
    this.show();
  }

  /** Paper has no buttons to turn pages: all chosen rows, in their order. */
  print(printing) {
    this.printing = printing;
    if (this.chosen.length > this.rowsAtOnce) this.show();
  }

  /** Say how many columns lie beyond the right side, since many systems hide the scroll bar. */
  showHidden() {
    const box = this.find('.table-scroll');
    const right = box.getBoundingClientRect().right + 1;
    const beyond = this.headers.filter((header) => header.getBoundingClientRect().right > right);
    const hint = this.find('.table-more');
    hint.hidden = beyond.length === 0 || box.scrollWidth <= box.clientWidth;
    hint.textContent = `${beyond.length} more ${beyond.length === 1 ? 'column' : 'columns'} →`;
  }

  /** Go on to the columns beyond the right side. */
  showMore() {
    const box = this.find('.table-scroll');
    box.scrollBy({ left: 0.8 * box.clientWidth, behavior: 'smooth' });
  }

  show() {
    const [first, many] = this.printing ? [0, Infinity] : [this.first, this.rowsAtOnce];
    const shown = this.chosen.slice(first, first + many);
    this.find('tbody').replaceChildren(...shown.map((row) => this.rowElement(row.cells)));
    this.showState();
  }

  showState() {
    const count = this.chosen.length;
    const last = Math.min(this.first + this.rowsAtOnce, count);
    const part = count > this.rowsAtOnce && !this.printing ? `${(this.first + 1).toLocaleString('en')}–${last.toLocaleString('en')} of ` : '';
    const rows = this.rows.length === 1 ? 'row' : 'rows';
    const all = [count, this.rows.length].map((number) => number.toLocaleString('en'));
    this.find('.table-state').textContent = `${part}${[...new Set(all)].join(' of ')} ${rows}`;
    this.enable('.page-before', this.first > 0);
    this.enable('.page-after', last < count);
  }

  enable(selector, enabled) {
    const button = this.find(selector);
    if (button) button.disabled = !enabled;
  }

  rowElement(cells) {
    return make('tr', {}, ...cells.map((cell, column) => {
      const text = this.shown(cell, column);
      const linked = column === this.runColumn && this.viewers.has(text);
      const inner = linked ? make('a', { href: runLink(text) }, text) : text;
      return make('td', { className: this.kind(text, column) }, inner);
    }));
  }

  /** Keep columns as wide as their longest words, or they would jump with every page. */
  keepWidths() {
    if (this.rows.length <= this.rowsAtOnce) return;
    this.headers.forEach((header, column) => {
      const lengths = this.rows.map(({ cells }) => this.text(cells[column], column).length);
      const longest = lengths.reduce((a, b) => Math.max(a, b), 0);
      header.style.minWidth = `calc(${Math.min(longest, LONG)}ch + 1.4rem)`;
    });
  }

  csv() {
    const names = this.columns.map(({ name }) => csvField(name, true));
    const lines = this.chosen.map(({ cells }) => cells.map((cell, column) => (
      cell === null ? '' : csvField(this.text(cell, column), !this.columns[column].numeric)
    )));
    return [names, ...lines].map((fields) => `${fields.join(',')}\n`).join('');
  }

  async copy(button) {
    const before = button.textContent;
    try {
      await navigator.clipboard.writeText(this.csv());
      const count = this.chosen.length;
      button.textContent = `${count.toLocaleString('en')} ${count === 1 ? 'row' : 'rows'} copied`;
    } catch {
      button.textContent = 'The browser refuses';
    }
    setTimeout(() => { button.textContent = before; }, 2000);
  }
}
