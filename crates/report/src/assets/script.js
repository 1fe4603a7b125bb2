(function () {
  'use strict';
  // Legend: switch classes of the page on and off.
  document.querySelectorAll('[data-switch]').forEach(function (button) {
    button.addEventListener('click', function () {
      var off = document.body.classList.toggle('off-' + button.dataset.switch);
      button.setAttribute('aria-pressed', String(!off));
    });
  });
  // Tables: sort by the clicked column, numbers downwards first.
  document.querySelectorAll('table.sortable').forEach(function (table) {
    table.querySelectorAll('thead th').forEach(function (head, column) {
      head.addEventListener('click', function () {
        var sign = head.dataset.sign === '-1' ? 1 : -1;
        head.dataset.sign = String(sign);
        var body = table.tBodies[0];
        var value = function (row) { return (row.cells[column] || row.cells[0]).textContent.trim(); };
        var rows = Array.prototype.slice.call(body.rows).sort(function (a, b) {
          var x = parseFloat(value(a).replace(/\u2009/g, '')), y = parseFloat(value(b).replace(/\u2009/g, ''));
          if (isNaN(x) || isNaN(y)) { return isNaN(x) - isNaN(y) || sign * value(b).localeCompare(value(a)); }
          return sign * (x - y);
        });
        rows.forEach(function (row) { body.appendChild(row); });
      });
    });
  });
  // Charts: a cursor with the values below the pointer; in charts over time at the same instant everywhere.
  var tip = document.createElement('div');
  tip.id = 'tip';
  tip.hidden = true;
  document.body.appendChild(tip);
  function axis(svg, name) {
    var d = (svg.dataset[name] || '').split(' ').map(Number);
    return d.length === 5 ? { low: d[0], high: d[1], from: d[2], to: d[3], log: d[4] === 1 } : null;
  }
  function valueAt(s, px) {
    var f = (px - s.from) / (s.to - s.from);
    return s.log ? s.low * Math.pow(s.high / s.low, f) : s.low + f * (s.high - s.low);
  }
  function points(path) {
    if (!path.cachedPoints) {
      path.cachedPoints = path.getAttribute('d').split(/[ML]/).slice(1).map(function (p) { return p.replace('h0', '').split(' ').map(Number); });
    }
    return path.cachedPoints;
  }
  function show(v) { return Math.abs(v) >= 100 ? v.toFixed(0) : v.toPrecision(3); }
  function cursor(svg, px) {
    var line = svg.querySelector('.cursor');
    if (!line) {
      line = document.createElementNS(svg.namespaceURI, 'path');
      line.setAttribute('class', 'cursor');
      svg.appendChild(line);
    }
    var y = axis(svg, 'y');
    var box = svg.viewBox.baseVal;
    line.setAttribute('d', px === null ? '' : 'M' + px + ' ' + (y ? y.to : 10) + 'V' + (y ? y.from : box.height - 50));
  }
  function leave(charts) {
    tip.hidden = true;
    charts.forEach(function (svg) { cursor(svg, null); });
  }
  document.querySelectorAll('.charts').forEach(function (section) {
    var timed = Array.prototype.slice.call(section.querySelectorAll('figure.time svg'));
    section.querySelectorAll('figure:not(.plan) svg[data-x]').forEach(function (svg) {
      var linked = timed.indexOf(svg) >= 0 ? timed : [svg];
      svg.addEventListener('pointerleave', function () { leave(linked); });
      svg.addEventListener('pointermove', function (event) {
        var matrix = svg.getScreenCTM();
        if (!matrix) { return; }
        var x = axis(svg, 'x'), y = axis(svg, 'y'), px = (event.clientX - matrix.e) / matrix.a;
        if (px < x.from || px > x.to) { leave(linked); return; }
        var at = valueAt(x, px);
        linked.forEach(function (other) {
          var s = axis(other, 'x');
          var f = (px - x.from) / (x.to - x.from);
          cursor(other, s.from + f * (s.to - s.from));
        });
        var lines = [(linked === timed ? 't = ' : '') + show(at)];
        svg.querySelectorAll('[data-name]').forEach(function (path) {
          if (!y || getComputedStyle(path).display === 'none') { return; }
          var best = null;
          points(path).forEach(function (p) { if (!best || Math.abs(p[0] - px) < Math.abs(best[0] - px)) { best = p; } });
          if (best && Math.abs(best[0] - px) < 8) { lines.push(path.dataset.name + ': ' + show(valueAt(y, best[1]))); }
        });
        tip.textContent = lines.join('\n');
        tip.hidden = false;
        var w = tip.offsetWidth;
        tip.style.left = Math.max(4, Math.min(event.clientX + 14, innerWidth - w - 4)) + 'px';
        tip.style.top = Math.max(4, event.clientY - tip.offsetHeight - 12) + 'px';
      });
    });
  });
})();
