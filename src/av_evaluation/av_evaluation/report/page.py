"""A report as one HTML file: headings, paragraphs, tables and figures, without links to other files."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Collection, Sequence
from pathlib import Path

from matplotlib.figure import Figure

STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.55 system-ui, sans-serif; color: #1c2430; background: #f5f6f8; margin: 0; }
main { max-width: 1280px; margin: 0 auto; padding: 2.5rem 2rem 4rem; background: #fff; box-shadow: 0 0 24px #0001; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .4rem; }
h2 { font-size: 1.35rem; margin: 2.8rem 0 .6rem; padding-top: .6rem; border-top: 2px solid #1f4fd8; }
h3 { font-size: 1.05rem; margin: 1.8rem 0 .3rem; }
p.lead, figcaption, .note { color: #566070; }
figure { margin: 1.2rem 0; } figure img { width: 100%; border: 1px solid #e3e6ea; border-radius: 4px; }
figcaption { font-size: .9rem; margin-top: .3rem; }
table { border-collapse: collapse; margin: 1rem 0; font-size: .88rem; font-variant-numeric: tabular-nums; }
th, td { padding: .36rem .55rem; text-align: right; border-bottom: 1px solid #e3e6ea; white-space: nowrap; }
th { font-weight: 600; background: #f0f2f6; white-space: normal; vertical-align: bottom; }
th:first-child, td:first-child { text-align: left; }
tr.ours td { background: #eef3ff; font-weight: 600; }
tr.theirs td { color: #7a4b00; background: #fff7ea; } .scroll { overflow-x: auto; }
code { background: #f0f2f6; padding: .1rem .35rem; border-radius: 3px; font-size: .88em; }
"""


class Page:
    """A report that is built part by part. Texts are plain; what stands between backticks is set as code.

    Parameters:
        title: of the page.
        lead: paragraph below the title, empty for none.
    """

    def __init__(self, title: str, lead: str = '') -> None:
        self._title = title
        self._parts = [f'<h1>{_text(title)}</h1>']
        if lead:
            self._parts.append(f'<p class="lead">{_text(lead)}</p>')

    def heading(self, text: str, level: int = 2) -> None:
        """Add a heading.

        Parameters:
            text: of the heading.
            level: 1 to 6, as in HTML.
        """
        self._parts.append(f'<h{level}>{_text(text)}</h{level}>')

    def paragraph(self, text: str) -> None:
        """Add a paragraph."""
        self._parts.append(f'<p>{_text(text)}</p>')

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]], ours: str = '', theirs: Collection[str] = ()) -> None:
        """Add a table.

        Parameters:
            head: cells of the header.
            rows: cells of each row, as many as in the header.
            ours: first cell of the row that is highlighted as this project's.
            theirs: first cells of the rows that are highlighted as the publication's.
        """
        kinds = {**dict.fromkeys(theirs, ' class=theirs'), **({ours: ' class=ours'} if ours else {})}
        cells = ''.join(f'<th>{_text(cell)}</th>' for cell in head)
        body = ''.join(f'<tr{kinds.get(row[0], "")}>'
                       + ''.join(f'<td>{_text(cell)}</td>' for cell in row) + '</tr>' for row in rows)
        self._parts.append(f'<div class="scroll"><table><thead><tr>{cells}</tr></thead><tbody>{body}</tbody></table></div>')

    def figure(self, figure: Figure | bytes, caption: str) -> None:
        """Add a figure.

        Parameters:
            figure: of matplotlib, or the bytes of a PNG file.
            caption: text below it, and its alternative text.
        """
        if isinstance(figure, Figure):
            content = io.BytesIO()
            figure.savefig(content, format='png', dpi=120)
            figure = content.getvalue()
        encoded = base64.b64encode(figure).decode()
        self._parts.append(f'<figure><img alt="{html.escape(caption, quote=True)}" src="data:image/png;base64,{encoded}">'
                           f'<figcaption>{_text(caption)}</figcaption></figure>')

    def write(self, path: Path) -> None:
        """Write the page to a file."""
        path.write_text(f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{_text(self._title)}</title>'
                        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head>'
                        f'<body><main>{"".join(self._parts)}</main></body></html>\n')


def _text(text: str) -> str:
    """Escaped for HTML, with what stands between backticks as code."""
    parts = html.escape(str(text)).split('`')
    return ''.join(f'<code>{part}</code>' if number % 2 else part for number, part in enumerate(parts))
