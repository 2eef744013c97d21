"""Write into the cards of the shipped networks what their training programs draw.

New cards have it from the pictures themselves; these networks were trained before. A program that
is not shipped (`learned`, of a search through s_falsif) draws parts of what s_falsif draws.
"""

import dataclasses

from taxinet_ros.core.perception.domain import domain_of_scenes, domain_words, joined_domains
from taxinet_ros.core.perception.weights import SHIPPED, load_model, save_model
from taxinet_ros.training.data.dataset import draw_scenes

SCENES = 4000
models = {word: load_model(path) for word, path in SHIPPED.items()}
drawn = {
    program: domain_of_scenes(
        scene.to_human() for scene in draw_scenes(program, seed=1, images=SCENES))
    for program in sorted({
        source.name for model in models.values() for source in model.card.training_data
    } - {'learned'})
}


def domain_of(card):
    """The domain of a card's programs and of the network that its training started from."""
    first = [model.card for model in models.values() if model.fingerprint == card.start_sha256]
    return joined_domains([
        *(drawn[source.name] for source in card.training_data if source.name in drawn),
        *map(domain_of, first),
    ])


for word, model in models.items():
    card = dataclasses.replace(model.card, domain=domain_of(model.card))
    save_model(SHIPPED[word], SHIPPED[word].read_bytes(), card)
    print(f'{word}: {domain_words(card.domain)}')
