"""A report as one HTML file: headings, paragraphs, tables and figures, without links to other files."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 1280px; margin: 2rem auto; padding: 0 2rem; }
h2 { margin-top: 2.8rem; border-top: 2px solid #1f4fd8; }
p.lead, figcaption { color: #566070; }
figure { margin: 1.2rem 0; } figure img { width: 100%; }
.scroll { overflow-x: auto; } table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; }
th, td { padding: .36rem .55rem; text-align: right; border-bottom: 1px solid #e3e6ea; }
th:first-child, td:first-child { text-align: left; }
tr.ours td { background: #eef3ff; font-weight: 600; }
"""


class Page:
    """A report that is built part by part. Texts are plain; what stands between backticks is set as code.

    Parameters:
        title: of the page.
        lead: paragraph below the title.
    """

    def __init__(self, title: str, lead: str) -> None:
        self._title = title
        self._parts = [f'<h1>{_text(title)}</h1>', f'<p class="lead">{_text(lead)}</p>']

    def heading(self, text: str) -> None:
        """Add a heading."""
        self._parts.append(f'<h2>{_text(text)}</h2>')

    def paragraph(self, text: str) -> None:
        """Add a paragraph."""
        self._parts.append(f'<p>{_text(text)}</p>')

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]], ours: str = '') -> None:
        """Add a table.

        Parameters:
            head: cells of the header.
            rows: cells of each row, as many as in the header.
            ours: first cell of the row that is highlighted as this project's.
        """
        cells = ''.join(f'<th>{_text(cell)}</th>' for cell in head)
        body = ''.join(f'<tr{" class=ours" if row[0] == ours else ""}>'
                       + ''.join(f'<td>{_text(cell)}</td>' for cell in row) + '</tr>' for row in rows)
        self._parts.append(f'<div class="scroll"><table><thead><tr>{cells}</tr></thead><tbody>{body}</tbody></table></div>')

    def figure(self, figure: Figure, caption: str) -> None:
        """Add a figure.

        Parameters:
            figure: the figure.
            caption: text below it, and its alternative text.
        """
        content = io.BytesIO()
        figure.savefig(content, format='png', dpi=120)
        encoded = base64.b64encode(content.getvalue()).decode()
        self._parts.append(f'<figure><img alt="{html.escape(caption, quote=True)}" src="data:image/png;base64,{encoded}">'
                           f'<figcaption>{_text(caption)}</figcaption></figure>')

    def write(self, path: Path) -> None:
        """Write the page to a file."""
        path.write_text(f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{_text(self._title)}</title>'
                        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head>'
                        f'<body>{"".join(self._parts)}</body></html>\n', encoding='utf-8')


def _text(text: str) -> str:
    """Escaped for HTML, with what stands between backticks as code."""
    parts = html.escape(str(text)).split('`')
    return ''.join(f'<code>{part}</code>' if number % 2 else part for number, part in enumerate(parts))
