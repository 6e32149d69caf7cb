"""Makes the files in tflite_fixtures: TensorFlow's own exports of two networks, and what its interpreter says of them.

    pip install tensorflow-cpu==2.21.0 numpy
    python models/tests/make_tflite_fixtures.py

Run once; the files are kept. The networks have random weights: what is tested is arithmetic. Inputs follow from their
number by the formula in `inputs` (tflite_fixtures_check.py), which the test repeats, so only the outputs are kept.
"""

import os

os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"
os.environ["TF_USE_LEGACY_KERAS"] = "0"

import numpy as np
import tensorflow as tf

from tflite_fixtures_check import OUT, ROWS, answers, inputs


def network(widths, *, bias=True, activation="relu", softmax=True, flatten=None, seed=7):
    tf.keras.utils.set_random_seed(seed)
    shape = flatten or (widths[0],)
    layers = [tf.keras.layers.Input(shape, batch_size=1)]
    if flatten:
        layers.append(tf.keras.layers.Flatten())
    for width in widths[1:-1]:
        layers.append(tf.keras.layers.Dense(width, activation=activation, use_bias=bias, bias_initializer="random_normal"))
    layers.append(tf.keras.layers.Dense(widths[-1], activation="softmax" if softmax else None, use_bias=bias,
                                        bias_initializer="random_normal"))
    model = tf.keras.Sequential(layers)
    # Rows of different size, so that scales per channel differ.
    rng = np.random.default_rng(seed)
    for layer in model.layers:
        values = layer.get_weights()
        if values:
            values[0] = values[0] * rng.uniform(0.3, 3.0, values[0].shape[1])
            layer.set_weights(values)
    return model


def convert(model, *, io="int8", per_channel=True, quantise=True, shape=None, dynamic=False, float16=False):
    converter = tf.lite.TFLiteConverter.from_keras_model(model)
    if quantise or dynamic or float16:
        converter.optimizations = [tf.lite.Optimize.DEFAULT]
    if float16:
        converter.target_spec.supported_types = [tf.float16]
    if quantise:
        rng = np.random.default_rng(3)
        samples = rng.normal(0, 1, (200,) + tuple(shape)).astype(np.float32)
        converter.representative_dataset = lambda: ([sample[np.newaxis]] for sample in samples)
        converter.target_spec.supported_ops = [tf.lite.OpsSet.TFLITE_BUILTINS_INT8]
        if io != "float":
            kind = {"int8": tf.int8, "uint8": tf.uint8}[io]
            converter.inference_input_type = converter.inference_output_type = kind
        converter._experimental_disable_per_channel_quantization_for_dense_layers = not per_channel
    return converter.convert()


def interpreter(model: bytes):
    return tf.lite.Interpreter(model_content=model, num_threads=1,
                               experimental_op_resolver_type=tf.lite.experimental.OpResolverType.BUILTIN_REF)


def main() -> None:
    OUT.mkdir(exist_ok=True)
    for name, widths, flatten in (("paper", [117, 20, 10, 5, 7], (9, 13)), ("three", [39, 24, 12, 5], (3, 13))):
        width = widths[0]
        plain, shape = network(widths), (width,)
        modes = {
            "int8": convert(plain, shape=shape),
            "uint8": convert(plain, io="uint8", shape=shape),
            "float-io": convert(plain, io="float", shape=shape),
            "per-tensor": convert(plain, per_channel=False, shape=shape),
            "reshape": convert(network(widths, flatten=flatten), shape=flatten),
            "logits": convert(network(widths, softmax=False), shape=shape),
            "no-bias": convert(network(widths, bias=False), shape=shape),
            "relu6": convert(network(widths, activation="relu6"), shape=shape),
        }
        rows = inputs(ROWS, width)
        for mode, model in modes.items():
            (OUT / f"{name}-{mode}.tflite").write_bytes(model)
            (OUT / f"{name}-{mode}.answers.bin").write_bytes(answers(interpreter(model), rows).tobytes())
            print(name, mode, len(model))
    # What is refused by name. The smaller network's weights are too few for TensorFlow to quantise them alone.
    plain, shape = network([117, 20, 10, 5, 7]), (117,)
    for mode, model in {
        "float": convert(plain, quantise=False),
        "dynamic": convert(plain, quantise=False, dynamic=True),
        "float16": convert(plain, quantise=False, float16=True),
        "tanh": convert(network([117, 20, 10, 5, 7], activation="tanh"), shape=shape),
    }.items():
        (OUT / f"paper-{mode}.tflite").write_bytes(model)
        print("paper", mode, len(model))


main()
