// Plugin of oclgrind that counts how accesses to local memory fall on banks, as a GPU of NVIDIA has them: 32 work-items side by side (a
// warp) access together, and the words of 4 bytes that they touch lie in 32 banks, each of which gives one word in a cycle, to all who ask
// for it. At the end it writes a line for each kernel that has local memory: its name; accesses by warps; wavefronts (cycles: the most
// words that any bank has to give); ideal (those that the same words would take, spread evenly). .ci/gpu-check builds and runs it.
//
// Work-items run here one after the other, from barrier to barrier, so accesses that belong together are found afterwards: they are of the
// same instruction, of the same warp and of the same turn. A turn is told by the largest number of times that the work-item has executed any
// instruction since the barrier, which in a loop is that of its head: a work-item that leaves out a part of a turn stays in step with the others.
// Loads, or stores, of a turn in which every work-item stays in a block of 16 bytes of its own count as one, as compilers for GPUs make
// vectors of them: of a struct of 12 words 3 are left. Words of a vector count like any others, those of all 32 lanes together.
#include <algorithm>
#include <array>
#include <fstream>
#include <map>
#include <oclgrind/Context.h>
#include <oclgrind/KernelInvocation.h>
#include <oclgrind/Memory.h>
#include <oclgrind/Plugin.h>
#include <oclgrind/WorkGroup.h>
#include <oclgrind/WorkItem.h>
#include <set>
#include <tuple>
#include <unordered_map>
#include <vector>

// The one member that is asked for; oclgrind/Kernel.h needs LLVM's headers.
class oclgrind::Kernel {
public:
  const std::string &getName() const;
};

namespace {
using namespace oclgrind;

constexpr size_t WARP = 32, BANKS = 32, WORD = 4, VECTOR = 4;

struct Count {
  size_t accesses = 0, wavefronts = 0, ideal = 0;
};

// Since the last barrier: how often a work-item has executed each instruction, the most of those, and accesses of each instruction and turn.
struct Item {
  std::unordered_map<const llvm::Instruction *, size_t> executed;
  std::map<std::tuple<const llvm::Instruction *, size_t>, size_t> accesses;
  size_t turn = 0;
};

class BankConflicts : public Plugin {
public:
  using Plugin::Plugin;

  bool isThreadSafe() const override { return false; }

  void kernelBegin(const KernelInvocation *invocation) override { kernel = invocation->getKernel()->getName(); }

  void instructionExecuted(const WorkItem *item, const llvm::Instruction *instruction, const TypedValue &) override {
    Item &state = items[item->getLocalID().x];
    state.turn = std::max(state.turn, ++state.executed[instruction]);
  }

  void memoryLoad(const Memory *memory, const WorkItem *item, size_t address, size_t size) override {
    access(memory, item, address, size, false);
  }

  void memoryStore(const Memory *memory, const WorkItem *item, size_t address, size_t size, const uint8_t *) override {
    access(memory, item, address, size, true);
  }

  void workGroupBarrier(const WorkGroup *, uint32_t) override { count(); }

  void workGroupComplete(const WorkGroup *) override { count(); }

  void write(std::ostream &out) const {
    for (const auto &[name, c] : counts) out << name << ',' << c.accesses << ',' << c.wavefronts << ',' << c.ideal << '\n';
  }

private:
  using Lanes = std::vector<std::pair<size_t, size_t>>; // work-items, and each one's word or block
  using Key = std::tuple<size_t, size_t, bool, const llvm::Instruction *, size_t>; // warp, turn, store?, instruction, access in the turn
  using Merged = std::tuple<size_t, size_t, bool, Lanes>;

  std::string kernel;
  std::map<std::string, Count> counts;
  std::unordered_map<size_t, Item> items;
  std::map<Key, Lanes> words;

  void access(const Memory *memory, const WorkItem *item, size_t address, size_t size, bool store) {
    if (memory->getAddressSpace() != AddrSpaceLocal) return;
    const size_t local = item->getLocalID().x;
    Item &state = items[local];
    const llvm::Instruction *instruction = item->getCurrentInstruction();
    for (size_t byte = 0; byte < size; byte += WORD) {
      const size_t nth = state.accesses[{instruction, state.turn}]++;
      words[{local / WARP, state.turn, store, instruction, nth}].push_back({local, (address + byte) / WORD});
    }
  }

  void count() {
    std::map<Merged, std::set<size_t>> merged;
    for (const auto &[key, lanes] : words) {
      Lanes blocks = lanes;
      for (auto &lane : blocks) lane.second /= VECTOR;
      const auto &[warp, turn, store, instruction, nth] = key;
      auto &all = merged[{warp, turn, store, blocks}];
      for (const auto &lane : lanes) all.insert(lane.second);
    }
    for (const auto &entry : merged) {
      std::array<size_t, BANKS> bank{};
      for (size_t word : entry.second) bank[word % BANKS]++;
      Count &c = counts[kernel];
      c.accesses++;
      c.wavefronts += *std::max_element(bank.begin(), bank.end());
      c.ideal += (entry.second.size() + BANKS - 1) / BANKS;
    }
    words.clear();
    items.clear();
  }
};

BankConflicts *plugin;
} // namespace

extern "C" void initializePlugins(Context *context) { context->registerPlugin(plugin = new BankConflicts(context)); }

// Written to the file that BANK_CONFLICTS names.
extern "C" void releasePlugins(Context *context) {
  context->unregisterPlugin(plugin);
  std::ofstream out(getenv("BANK_CONFLICTS"));
  plugin->write(out);
  delete plugin;
}
