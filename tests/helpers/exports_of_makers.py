"""Exports as several makers' software writes them, made by hand from truth.

Each takes times, places, status and names of rows, and returns the file with the
options that its import needs. Nothing of the importer is used.
"""

import datetime

DAY = datetime.datetime(2026, 3, 1, tzinfo=datetime.UTC)


def clock(t, begin="23:59:40", form="%H:%M:%S.%f"):
    hour, minute, second = map(int, begin.split(":"))
    start = DAY + datetime.timedelta(hours=hour, minutes=minute, seconds=second)
    return (start + datetime.timedelta(seconds=round(float(t), 6))).strftime(form)


def leica(time_s, position, status, names):
    """ISO times across midnight, a running number, air beside it, Windows line ends."""
    head = "Point ID,X [mm],Y [mm],Z [mm],Timestamp,Temperature [°C],Humidity [%]"
    rows = ["Tracker Pilot", "Job: acceptance", "", head]
    for t, p, name in zip(time_s, position, names, strict=True):
        stamp = clock(t - time_s[0], form="%Y-%m-%dT%H:%M:%S.%fZ")
        rows.append(",".join([name, *(f"{v:.5f}" for v in p), stamp, "20.4", "51"]))
    return "\r\n".join(rows).encode("utf-8-sig"), ()


def german(time_s, position, status, names):
    """Semicolons, decimal commas, metres, ms, a footer, the header twice, cp1252."""
    head = "Nr.;Zeit [ms];X-Ist [m];Y-Ist [m];Z-Ist [m];Temperatur Z (°C)"
    rows = ["Einheit: m", head, head]
    for k, (t, p, ok) in enumerate(zip(time_s, position, status, strict=True)):
        cells = [f"{v / 1e3:.7f}" for v in p] if ok == 0 else ["---"] * 3
        cells = [str(k + 1), f"{1e3 * t:.3f}", *cells, "21.25"]
        rows.append(";".join(cells).replace(".", ","))
    rows += ["", f"Anzahl Punkte: {len(time_s)}", "Ende"]
    return "\n".join(rows).encode("cp1252"), ()


def spatial(time_s, position, status, names):
    """Inches, commas with blanks, group and point in one name, epoch seconds."""
    rows = ["// SpatialAnalyzer", "// Units: Inches", "Units: Inches"]
    rows += ["Name, X, Y, Z, Epoch Time [s], Status"]
    for t, p, ok, name in zip(time_s, position, status, names, strict=True):
        cells = [f"A::run::{name}", *(f"{v / 25.4:.7f}" for v in p)]
        cells += [f"{1772323200 + t:.6f}", "OK" if ok == 0 else "LOST"]
        rows.append(", ".join(cells))
    return "\n".join(rows).encode(), ("--column", "time=Epoch Time [s]")


def french(time_s, position, status, names):
    """Tabs, decimal commas, a line of units, the time of day."""
    rows = ["Heure\tPosition X\tPosition Y\tPosition Z", "\tmm\tmm\tmm"]
    for t, p in zip(time_s, position, strict=True):
        cells = [clock(t, begin="10:00:00"), *(f"{v:.4f}" for v in p)]
        rows.append("\t".join(cells).replace(".", ","))
    return "\n".join(rows).encode("utf-16"), ()


def polyworks(time_s, position, status, names):
    """German, tabs, metres below the names, thousands, ms since the start, UTF-16."""
    rows = ["Punktname\tX gemessen\tY gemessen\tZ gemessen\tAbw. X\tZeit"]
    rows += ["\tmm\tmm\tmm\tmm\tms"]
    for t, p, name in zip(time_s, position, names, strict=True):
        cells = [name, *(f"{v:,.5f}" for v in p), "0.00100"]
        cells += [f"{1e3 * (t - time_s[0]):.3f}"]
        swap = str.maketrans(",.", ".,")
        rows.append("\t".join([cells[0], *(c.translate(swap) for c in cells[1:])]))
    return "\r\n".join(rows).encode("utf-16"), ()


def generic(time_s, position, status, names):
    """No names of columns, blanks, metres: all by hand."""
    rows = []
    for t, p, name in zip(time_s, position, names, strict=True):
        point = "".join(c for c in name if c.isdigit())
        cells = [point, *(f"{v / 1e3:.8f}" for v in p), clock(t - time_s[0])]
        rows.append(" ".join(cells))
    roles = ["point=1", "x=2", "y=3", "z=4", "time=5"]
    options = [word for role in roles for word in ("--column", role)]
    return "\n".join(rows).encode(), (*options, "--unit", "m", "--across-midnight")


def plain(time_s, position, *, head="t_s,x_mm,y_mm,z_mm", stamp="{:.6f}".format, d=4):
    """Commas, with whatever head, form of the time and decimals are asked for."""
    rows = [head] if head else []
    for t, p in zip(time_s, position, strict=True):
        rows.append(",".join([stamp(float(t)), *(f"{v:.{d}f}" for v in p)]))
    return "\n".join(rows).encode()


def of_stream(style, samples):
    """Write a stream; the first column of a generic one counts its samples."""
    names = [f"N{k + 1}" for k in range(len(samples))]
    measured = samples.device_time_s, samples.position_mm, samples.status
    data, options = style(*measured, names)
    return data, options[2:] if style is generic else options
