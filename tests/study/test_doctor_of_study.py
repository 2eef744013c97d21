"""What a study says that its stages have made is looked for by the doctor."""

from __future__ import annotations

from pathlib import Path

from taxinet_ros.campaign.doctor import examine
from taxinet_ros.campaign.sealed_json import file_sha256
from taxinet_ros.study.stage_log import StageLog


def test_doctor_given_what_a_stage_has_made_then_it_is_looked_for(tmp_path: Path) -> None:
    made = tmp_path / 'one' / 'result.parquet'
    made.parent.mkdir()
    made.write_bytes(b'1')
    with StageLog(tmp_path) as log:
        log.write('begin', 'one', identity='a', runs=1, resumed=False)
        outputs = {'one/result.parquet': file_sha256(made)}
        log.write('end', 'one', key='k', outputs=outputs, wall_s=1.0)
    assert examine(tmp_path).findings == []
    made.write_bytes(b'2')
    assert [(one.where, one.what) for one in examine(tmp_path).findings] == [
        (str(made), 'is not the file that stage one has made')
    ]
    made.unlink()
    assert [one.what for one in examine(tmp_path).findings] == [
        'is not there, and stage one has made it'
    ]
    with StageLog(tmp_path) as log:  # one that is begun anew makes it anew
        log.write('begin', 'one', identity='b', runs=1, resumed=False)
    assert examine(tmp_path).findings == []
