// 3x3 convolutions of stride 1 by Winograd's minimal filtering F(4x4, 3x3) (Lavin and Gray, Fast
// Algorithms for Convolutional Neural Networks, CVPR 2016): a quarter of the direct form's
// multiplications. The points are 0, +-sqrt(1/2), +-sqrt(2) and infinity, which round half as much
// as the usual 0, +-1, +-2 and infinity. Arrays are float32 with channels last. A dilation d splits
// the image into d * d images of every d-th pixel, each convolved by itself.

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstring>
#include <thread>
#include <vector>

namespace {

#ifdef __AVX512F__
constexpr int kLanes = 16, kRows = 12;
#else
constexpr int kLanes = 8, kRows = 6;
#endif
typedef float Vector __attribute__((vector_size(kLanes * sizeof(float)), aligned(4)));
constexpr int kPanel = 2 * kLanes;  // output channels of one panel of the filters
constexpr int kTile = 4, kPatch = 6, kPoints = kPatch * kPatch;
constexpr int kBlock = 24;  // tiles worked off together, whose values should stay in the cache

inline Vector load(const float* from) { return *reinterpret_cast<const Vector*>(from); }
inline Vector part(const float* from, int lanes) {
  Vector value = {};
  std::memcpy(&value, from, lanes * sizeof(float));
  return value;
}
inline void store(float* to, Vector value) { *reinterpret_cast<Vector*>(to) = value; }

constexpr float kNear = 0.70710678118654752f, kFar = 1.41421356237309505f;  // the points

// B^T d for six values.
inline void transform_input(const Vector d[kPatch], Vector out[kPatch]) {
  const Vector even1 = d[4] - 2 * d[2], odd1 = kNear * (d[3] - 2 * d[1]);
  const Vector even2 = d[4] - 0.5f * d[2], odd2 = kFar * (d[3] - 0.5f * d[1]);
  out[0] = d[0] - 2.5f * d[2] + d[4];
  out[1] = even1 + odd1;
  out[2] = even1 - odd1;
  out[3] = even2 + odd2;
  out[4] = even2 - odd2;
  out[5] = d[1] - 2.5f * d[3] + d[5];
}

// A^T m for six values.
inline void transform_output(const Vector m[kPatch], Vector out[kTile]) {
  const Vector even1 = m[1] + m[2], odd1 = kNear * (m[1] - m[2]);
  const Vector even2 = m[3] + m[4], odd2 = kFar * (m[3] - m[4]);
  out[0] = m[0] + even1 + even2;
  out[1] = odd1 + odd2;
  out[2] = 0.5f * even1 + 2 * even2;
  out[3] = 0.5f * odd1 + 2 * odd2 + m[5];
}

// rows x kPanel of c = a b: a (rows, inner) with row stride lda, b (inner, kPanel) packed.
template <int rows>
void multiply(const float* a, size_t lda, const float* b, int inner, float* c, size_t ldc) {
  Vector sum[rows][2] = {};
  for (int k = 0; k < inner; ++k, b += kPanel) {
    const Vector b0 = load(b), b1 = load(b + kLanes);
#pragma GCC unroll 16
    for (int r = 0; r < rows; ++r) {
      const float x = a[r * lda + k];
      sum[r][0] += x * b0;
      sum[r][1] += x * b1;
    }
  }
#pragma GCC unroll 16
  for (int r = 0; r < rows; ++r) {
    store(c + r * ldc, sum[r][0]);
    store(c + r * ldc + kLanes, sum[r][1]);
  }
}

template <int rows>
void multiply_rest(int left, const float* a, size_t lda, const float* b, int inner, float* c,
                   size_t ldc) {
  if constexpr (rows > 0) {
    if (left == rows) return multiply<rows>(a, lda, b, inner, c, ldc);
    multiply_rest<rows - 1>(left, a, lda, b, inner, c, ldc);
  }
}

struct Convolution {
  const float *input, *filters, *bias;
  float* output;
  int height, width, inputs, outputs, dilation, relu;

  int panels() const { return (outputs + kPanel - 1) / kPanel; }
  int step() const { return kTile * dilation; }
  int rows() const { return (height + step() - 1) / step(); }  // of tiles, in one phase
  int columns() const { return (width + step() - 1) / step(); }
  long tiles() const { return long(dilation) * dilation * rows() * columns(); }  // of one image

  // An input's channels of a tile, filled up to whole vectors. The planes of the 36 points lie a
  // cache line more than that apart, so that they do not share cache sets.
  size_t row_in() const { return size_t(inputs + kLanes - 1) / kLanes * kLanes; }
  size_t plane_in() const { return kBlock * row_in() + 16; }
  size_t row_out() const { return size_t(panels()) * kPanel; }
  size_t plane_out() const { return kBlock * row_out() + 16; }
  size_t workspace() const { return kPoints * (plane_in() + plane_out()) + row_in(); }

  // Image and top left pixel of a tile; tiles count image, row phase, row, column phase, column.
  void place(long tile, long& image, int& y, int& x) const {
    const long inside = tile % tiles();
    const int per_row = dilation * columns();
    const int line = int(inside / per_row), cell = int(inside % per_row);
    image = tile / tiles();
    y = line / rows() + line % rows() * step();
    x = cell / columns() + cell % columns() * step();
  }

  // B^T d B of `count` tiles from `first` on: (36, kBlock, inputs).
  void gather(long first, int count, const float* zeros, float* v) const {
    const int whole = inputs / kLanes * kLanes, rest = inputs - whole;
    for (int t = 0; t < count; ++t) {
      long image;
      int y, x;
      place(first + t, image, y, x);
      const float* patch[kPatch][kPatch];
      for (int i = 0; i < kPatch; ++i) {
        for (int j = 0; j < kPatch; ++j) {
          const int py = y + (i - 1) * dilation, px = x + (j - 1) * dilation;
          const bool inside = py >= 0 && py < height && px >= 0 && px < width;
          patch[i][j] = inside ? input + ((image * height + py) * width + px) * inputs : zeros;
        }
      }
      for (int c = 0; c < inputs; c += kLanes) {
        Vector half[kPatch][kPatch];
        for (int j = 0; j < kPatch; ++j) {
          Vector d[kPatch], out[kPatch];
          for (int i = 0; i < kPatch; ++i) {
            const float* from = patch[i][j] + c;
            d[i] = c < whole ? load(from) : part(from, rest);
          }
          transform_input(d, out);
          for (int i = 0; i < kPatch; ++i) half[i][j] = out[i];
        }
        for (int i = 0; i < kPatch; ++i) {
          Vector out[kPatch];
          transform_input(half[i], out);
          for (int j = 0; j < kPatch; ++j)
            store(v + (i * kPatch + j) * plane_in() + t * row_in() + c, out[j]);
        }
      }
    }
  }

  // The sums over the input channels, point by point: (36, kBlock, panels * kPanel).
  void multiply_points(int count, const float* v, float* m) const {
    const size_t lda = row_in(), ldc = row_out();
    for (int p = 0; p < kPoints; ++p) {
      for (int panel = 0; panel < panels(); ++panel) {
        const float* b = filters + (size_t(p) * panels() + panel) * inputs * kPanel;
        const float* a = v + p * plane_in();
        float* c = m + p * plane_out() + panel * kPanel;
        int r = 0;
        for (; r + kRows <= count; r += kRows)
          multiply<kRows>(a + r * lda, lda, b, inputs, c + r * ldc, ldc);
        multiply_rest<kRows - 1>(count - r, a + r * lda, lda, b, inputs, c + r * ldc, ldc);
      }
    }
  }

  // A^T m A of the tiles, with bias and ReLU, where they lie inside the image.
  void scatter(long first, int count, const float* m) const {
    for (int t = 0; t < count; ++t) {
      long image;
      int y, x;
      place(first + t, image, y, x);
      for (int c = 0; c < outputs; c += kLanes) {
        Vector half[kTile][kPatch];
        for (int j = 0; j < kPatch; ++j) {
          Vector values[kPatch], out[kTile];
          for (int i = 0; i < kPatch; ++i)
            values[i] = load(m + (i * kPatch + j) * plane_out() + t * row_out() + c);
          transform_output(values, out);
          for (int i = 0; i < kTile; ++i) half[i][j] = out[i];
        }
        const int lanes = std::min(kLanes, outputs - c);
        const Vector shift = lanes == kLanes ? load(bias + c) : part(bias + c, lanes);
        for (int i = 0; i < kTile && y + i * dilation < height; ++i) {
          Vector out[kTile];
          transform_output(half[i], out);
          for (int j = 0; j < kTile && x + j * dilation < width; ++j) {
            Vector value = out[j] + shift;
            if (relu) value = value < 0 ? Vector{} : value;  // NaN stays NaN
            const long pixel = (image * height + y + i * dilation) * width + x + j * dilation;
            std::memcpy(output + pixel * outputs + c, &value, lanes * sizeof(float));
          }
        }
      }
    }
  }

  // Blocks of tiles, as long as there are any left.
  void work(long all, std::atomic<long>& next, float* memory) const {
    float* const m = memory + kPoints * plane_in();
    float* const zeros = m + kPoints * plane_out();
    std::fill(zeros, zeros + row_in(), 0.f);
    for (long first; (first = next.fetch_add(kBlock)) < all;) {
      const int count = int(std::min<long>(kBlock, all - first));
      gather(first, count, zeros, memory);
      multiply_points(count, memory, m);
      scatter(first, count, m);
    }
  }
};

}  // namespace

extern "C" {

// Output channels that a panel of the filters holds.
int winograd_panel() { return kPanel; }

// Floats of working memory that each thread needs.
size_t winograd_workspace(int inputs, int outputs) {
  return Convolution{nullptr, nullptr, nullptr, nullptr, 1, 1, inputs, outputs, 1, 0}.workspace();
}

// The convolution with "same" padding of zeros. input (images, height, width, inputs); filters
// (36, panels, inputs, winograd_panel()), transformed; bias (outputs); output (images, height,
// width, outputs); memory (threads * winograd_workspace()). Every tile is worked out alone, so the
// result does not hang on the number of threads.
void winograd_convolve(const float* input, const float* filters, const float* bias, float* output,
                       float* memory, long images, int height, int width, int inputs, int outputs,
                       int dilation, int relu, int threads) {
  const Convolution one{input,  filters, bias,    output,   height,
                        width,  inputs,  outputs, dilation, relu};
  const long all = images * one.tiles();
  threads = int(std::clamp<long>((all + kBlock - 1) / kBlock, 1, threads));
  std::atomic<long> next{0};
  std::vector<std::thread> others;
  try {
    for (int i = 1; i < threads; ++i)
      others.emplace_back([&, i] { one.work(all, next, memory + i * one.workspace()); });
  } catch (...) {
    // No more threads to be had: those that there are do the work.
  }
  one.work(all, next, memory);
  for (std::thread& other : others) other.join();
}
}
