"""``taxinet train`` on the command line."""

from __future__ import annotations

import shlex

from taxinet_ros.training import fit as fitting


def test_the_interrupt_tells_the_command_that_goes_on(taxinet, tmp_path, monkeypatch):
    out, epoch = tmp_path / 'net.safetensors', fitting._Trainer.epoch

    def interrupted(self, number):
        if number == 2:
            raise KeyboardInterrupt
        return epoch(self, number)

    monkeypatch.setattr(fitting._Trainer, 'epoch', interrupted)
    code, _, err = taxinet(
        'train', 'nominal', '--images', '12', '--validation', '4', '--epochs', '2', '--batch', '4',
        '--workers', '1', '--out', str(out),
    )
    assert code == 130
    told, _, command = err.strip().rpartition('continue with taxinet ')
    assert told.endswith(f'interrupted; {tmp_path}/net.part keeps pictures and epochs, ')
    monkeypatch.undo()
    code, _, _ = taxinet(*shlex.split(command))
    assert (code, out.is_file(), (tmp_path / 'net.part').exists()) == (0, True, False)
