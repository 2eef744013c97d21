from setuptools import setup

NAME = 'my_perception_package'

setup(
    name=NAME,
    version='0.1.0',
    description='An example for taxinet_ros: a perception node in Python, with its tests.',
    license='Apache-2.0',
    packages=[NAME],
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
    ],
    entry_points={'console_scripts': [f'my_perception = {NAME}.perception:main']},
    extras_require={'test': ['pytest']},  # by which colcon sees that pytest runs the tests
    zip_safe=True,
)
