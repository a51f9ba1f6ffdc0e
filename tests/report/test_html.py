"""Sentences of the console as HTML."""

from ppmcal.report.html import bullets


def test_what_stands_in_backticks_is_code_and_the_rest_is_text() -> None:
    told = bullets(["a <b> `ppmcal diagnose` looks for it"])
    assert "a &lt;b&gt; <code>ppmcal diagnose</code> looks for it" in told
