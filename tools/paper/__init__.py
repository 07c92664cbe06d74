"""The paper's tables and figures for any two images; `tools/reproduce_paper.py` is the command.

One module an idea: `pair` (images), `setting` (parameters and published numbers), one for each
group of tables and figures, `drawing` (how they look) and `report` (the page).
"""
