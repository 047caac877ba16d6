import pypdf
import pytest


@pytest.mark.long
def test_a_certificate_is_printed_by_a_process_of_its_own(
    client, with_result, tmp_path
):
    place = f"/api/v1/jobs/{with_result}/certificates"
    asked = {"language": "de", "identity": {"operator": "A. Weiß", "warm_up": "2 h"}}
    made = client.post(place, json=asked).json()
    (tmp_path / "c.pdf").write_bytes(client.get(made["links"]["pdf"]).content)
    assert "A. Weiß" in pypdf.PdfReader(tmp_path / "c.pdf").pages[0].extract_text()
