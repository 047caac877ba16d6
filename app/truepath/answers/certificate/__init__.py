"""The calibration certificate: a result for the owner of the machine, on paper.

One template makes it in every language, as HTML; `pdf` prints the same HTML. Its
content comes from the files that it is made from: result, verification, compensation
record, and the identity that people state. What is unknown is shown as not stated.

Not here: the report of a calibration (`answers.calibration`).

    issue            what a certificate is made from, and whether it may be
    stated_results   its main numbers, once for pages and record
    language         texts, numbers and names in one language, from one table
    *_sections       views of the template's sections
    map_figures      pictures of the map
    document         the HTML
    pdf              the PDF
"""
